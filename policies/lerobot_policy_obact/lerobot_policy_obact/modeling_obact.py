"""ObAct in LeRobot: what is trained, what acts, and its network.

    encoders     find the target in the newest images (`encoders`)
    forecaster   attends to the observation history and forecasts the target
    condition    picks from the forecast where to meet it
    head         samples actions relative to that place (`heads`)

`ObActPolicy.forward` is the only loss; `ObActPolicy.select_action` asks the network for a chunk of
actions when the last one is used up.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, cast

import torch
from einops import einsum, rearrange, repeat
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from .attention import PositionReadout, TemporalBlock
from .camera import Pinhole
from .configuration_obact import HEADS, ObActConfig
from .encoders import ENCODERS, N_SIGHTING, Encoder
from .frames import Frames, Record, gather_frames, palm_of, stepped
from .heads import perceptron
from .threads import on_one_thread

if TYPE_CHECKING:
    from .dataset import TargetTable
    from .windows import Window

AVERAGED = "average.module."
"""Names of averaged weights begin so in a file."""
Batch = dict[str, Any]

FORECAST_FRAMES = (0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48)
"""Frames ahead at which the target's position is forecast."""
PLACE_M, RAY_M, POINT_M = 0.3, 0.4, 0.1
"""Units in which places, their offsets from the camera and differences between points enter the
network: about their standard deviations."""
FAR = 8.0  # inputs are cut to this many units
BEND_M, BEND_M_S = 0.03, 0.5
"""Unit in which the network corrects the forecast, and what is added to it for every second
ahead."""
OFFSET_M, OFFSET_M_S = 0.1, 0.3
"""Unit in which the head reads where the target will be, and how much more it is for every second
ahead."""
UNCALIBRATED = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""Calibration, see `Embodiment`, of a camera that sees rays of unit depth from the origin."""
N_FEATURES = 64  # numbers of a decision's token that the head reads beside the forecast


# -- policy ----------------------------------------------------------------------------------------


class Decision(NamedTuple):
    """What the newest decision of B environments was based on, for whoever draws it."""

    sightings: Tensor  # in the newest images, by camera, (B, C, 5 + E), see `Frames`
    sighted: Tensor  # where that is [m], (B, C, 3)
    forecast: Tensor  # of the target [m], (B, K, 3)
    ahead_s: Tensor  # when it is expected there, from now [s], (K,)
    intercept: Tensor  # where the palm is to meet it [m], (B, 3)
    # weights of the T frames of the history, oldest first, in J readouts, (B, J, T)
    attention: Tensor | None


class ObActPolicy(PreTrainedPolicy):
    """Observe before act (DynaHOI, Section 4).

    Args:
        config: the policy's config, with its features filled in.
        dataset_stats: LeRobot statistics of the training data; absent when a checkpoint is opened
            for acting.
        dataset_meta: LeRobot metadata of the training data.
        load_pretrained: whether encoders and head start from published weights, where they name
            any.
        **kwargs: what else LeRobot may pass, unused.
    """

    config_class: ClassVar[type[ObActConfig]] = ObActConfig
    name: ClassVar[str] = "obact"
    config: ObActConfig
    real_time: ClassVar[bool] = False
    """Whether the world moves on while a caller who asks for chunks waits: frames without
    ``timestamp`` are then as old as the wall clock says."""
    _shown: list[Tensor] | None = None  # what was observed last, also before `reset`

    def __init__(
        self,
        config: ObActConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any | None = None,
        load_pretrained: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(config)
        config.validate_features()
        self.targets: TargetTable | None = None
        if dataset_meta is not None:
            self._describe(dataset_meta)
        self.model = ObActModel(config)
        if load_pretrained:
            self.model.load_pretrained()
        if dataset_stats is not None:
            self.model.adopt_stats(dataset_stats)
        self.average = AveragedModel(self.model).requires_grad_(False) if config.ema_decay else None
        self.reset()

    def _describe(self, meta: Any) -> None:
        """Take over what a dataset says of the robot and the targets."""
        from .dataset import TargetTable, embodiment_of, rules_of

        config = self.config
        config.rules = rules_of(meta)
        knew, config.embodiment = config.forecasts, embodiment_of(meta, config.cameras)
        if config.pretrained_path and knew and not config.forecasts:
            raise ValueError(
                f"{config.pretrained_path} learned from the target's path, which "
                f"{meta.repo_id} lacks; "
                "train from random weights, or record with dynahoi generate --actor"
            )
        encoded = meta.features.keys() >= {*config.sighting_keys}
        if config.n_future_steps and not encoded:
            raise ValueError(
                f"n_future_steps is {config.n_future_steps}, but must be 0 for a dataset with "
                f"images, of which it would decode as many more: `dynahoi encode` turns them into "
                f"sightings"
            )
        if encoded and not (config.forecasts and config.n_future_steps):
            lacking = "n_future_steps is 0" if config.forecasts else "it lacks the target's path"
            logging.warning("the closed loop is off for %s: %s", meta.repo_id, lacking)
        if config.forecasts:
            self.targets = TargetTable.of(meta, config.embodiment)
            # it reads no other vectors, which a robot may not have
            read = {*config.cameras, OBS_STATE}
            config.input_features = {
                key: x for key, x in (config.input_features or {}).items() if key in read
            }

    # -- training ----------------------------------------------------------------------------------

    def forward(self, batch: Batch, reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a preprocessed batch, and what to log.

        ``reduction`` is "mean" for a scalar, "none" for one loss per sample, ``(B,)``.
        """
        from .losses import window_losses
        from .windows import VirtualHands

        config, window = self.config, self._window(batch)
        model, teacher = self.model if self.training else self.acting, None
        if self.targets is not None:
            teacher = self.targets.teacher
            hands = VirtualHands(config, teacher, self.acting)
            share = config.virtual_share if self.training else 0.0
            window = hands.drawn(window.repeated(config.n_hands), share)
        losses = window_losses(model, window, teacher)
        weights = {
            "forecast": config.forecast_weight,
            "action": config.action_weight,
            "missed": config.action_weight,
            "closed_loop": config.closed_loop_weight * self._is_competent(),
        }
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum(0)
        if self.targets is not None:
            weight = self.targets.weight[batch["episode_index"].flatten().cpu()].to(total)
            total = total * weight.repeat_interleave(config.n_hands)
        logged = {name: float(loss.detach().mean()) for name, loss in losses.items()}
        if reduction == "none":
            return rearrange(total, "(b n) -> b n", b=len(batch[ACTION])).mean(1), logged
        return total.mean(), logged

    def _window(self, batch: Batch) -> Window:
        """Return the windows of a batch, with the targets in them, if the dataset has these."""
        from .windows import Window

        config, model = self.config, self.model
        actions, offsets = batch[ACTION], config.observation_delta_indices
        b, n, device = len(actions), len(offsets), actions.device
        columns = config.sighting_keys
        if columns[0] in batch:
            sightings = torch.stack([batch[key] for key in columns], dim=2)
        else:
            images = {key: batch[key] for key in config.cameras}
            before = {key: torch.cat([x[:, :1], x[:, :-1]], 1) for key, x in images.items()}
            flat = ({key: x.flatten(0, 1) for key, x in y.items()} for y in (images, before))
            sightings = model.encode_images(*flat).unflatten(0, (b, n))
        observed = (columns[0] if columns[0] in batch else config.cameras[0]) + "_is_pad"
        recorded = ~batch.get(observed, torch.zeros(b, n, dtype=torch.bool, device=device))
        before_start = ~recorded & (torch.arange(n, device=device) < config.n_obs_steps)
        time_s = torch.tensor(offsets, device=device) / config.embodiment.fps
        frames = Frames(sightings, model.state_of(batch), time_s, before_start)
        padding = batch.get(f"{ACTION}_is_pad", torch.zeros(actions.shape[:2], dtype=torch.bool))
        weight = (~padding).float().to(device)
        begin = torch.zeros(b, dtype=torch.long, device=device)
        window = Window(frames, recorded, actions, weight, begin)
        if self.targets is None:
            return window
        episode, index = (batch[key].flatten().cpu() for key in ("episode_index", "index"))
        first = index - self.targets.first_index[episode] + offsets[0]
        targets, begin = self.targets.window(episode, first, n)
        return replace(window, begin=begin.to(device), targets=targets.to(device))

    def _is_competent(self) -> bool:
        """Whether it has imitated for long enough to learn from what its own hands do."""
        steps = self.config.imitation_steps
        return self.average is None or int(self.average.n_averaged) >= steps

    def update(self) -> None:
        """Update the averaged weights after an optimizer step; random first weights are soon
        forgotten.
        """
        if self.average is not None:
            n = int(self.average.n_averaged)
            self.average.multi_avg_fn = get_ema_multi_avg_fn(
                min(self.config.ema_decay, (1 + n) / (10 + n))
            )
            self.average.update_parameters(self.model)

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return parameter groups: weight decay for matrices, none for biases, norms and biases by
        age.
        """
        trained = [p for p in self.model.parameters() if p.requires_grad]
        return [
            {"params": [p for p in trained if p.dim() >= 2]},
            {"params": [p for p in trained if p.dim() < 2], "weight_decay": 0.0},
        ]

    # -- acting ------------------------------------------------------------------------------------

    @property
    def acting(self) -> ObActModel:
        """The weights that act: the averaged ones."""
        return self.model if self.average is None else cast("ObActModel", self.average.module)

    @property
    def _actor(self) -> ObActModel:
        """The network that acts until the next reset, in double precision.

        The last digits of a network depend on the size of the batch, on threads and on the
        processor, and an edge that moves by a pixel makes them grow. Actions that are rounded to
        single precision do not depend on them.
        """
        if not self._actors:
            self._actors.append(
                deepcopy(self.acting).double() if self.config.exact else self.acting
            )
        return self._actors[0]

    def reset(self) -> None:
        """Forget the last episode."""
        self._actors: list[ObActModel] = []  # in a list, or PyTorch would save it with the weights
        self._history: deque[Frames] = deque(maxlen=self.config.history_steps)
        self._frame = -1  # the number of the newest one
        self._began_s = self._now_s = 0.0  # when the first and the newest one were seen
        self._images: dict[str, Tensor] = {}
        self._stale = False  # whether the only frame is the last one of the episode before
        self._action_queue: deque[Tensor] = deque()
        self._commands: dict[int, Tensor] = {}  # where palms were sent to [m], by frame, (B, 3)
        self.decision: Decision | None = None  # the newest

    @on_one_thread
    @torch.no_grad()
    def select_action(self, batch: Batch, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, ``(B, A)``; call it once per control step.

        A frame is as old as its ``timestamp`` says, or, if the batch has none, as calls at
        ``embodiment.fps`` say. While actions are queued, a frame that is shown again counts once:
        the world stands still until they have been read.
        """
        self.eval()
        config = self.config
        if not (self._action_queue and self._is_shown_again(batch)):
            self._see(batch, self._now_s + 1 / config.embodiment.fps)
        if not self._action_queue:
            chunk = self._chunk(config.inference_delay)
            self._action_queue.extend(chunk[:, : config.n_action_steps].unbind(1))
        return self._action_queue.popleft()

    def keep_rows(self, rows: Any) -> None:
        """Go on with the environments of the sorted rows ``(R,)`` of the batch alone; what they do
        does not depend on the others.
        """
        kept = [
            replace(frame, sightings=frame.sightings[rows], state=frame.state[rows])
            for frame in self._history
        ]
        self._history = deque(kept, maxlen=self._history.maxlen)
        self._images = {key: images[rows] for key, images in self._images.items()}
        self._action_queue = deque(actions[rows] for actions in self._action_queue)
        self._commands = {frame: goals[rows] for frame, goals in self._commands.items()}

    def _is_shown_again(self, batch: Batch) -> bool:
        """Whether a batch is the newest frame again."""
        state, images = self._history[-1].state[:, 0], self._images
        shown = {key: batch[key].to(image) for key, image in images.items()}
        same = all(image.equal(shown[key]) for key, image in images.items())
        return same and self._actor.state_of(batch).to(state).equal(state)

    @on_one_thread
    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch, inference_delay: int = 0, **kwargs: Any) -> Tensor:
        """Return a whole chunk, ``(B, H, A)``.

        A frame is as old as its ``timestamp`` says, or, if the batch has none, ``n_action_steps``
        later than the one before, as in a simulation that waits. In `real_time`, and if a previous
        chunk is offered, as by LeRobot's real-time chunking, the wall clock says how old it is.

        Its first ``inference_delay`` actions are past when it is there; the others follow from the
        forecast and from where the palm will be by then, or, without a forecast, are those expected
        of a hand that acts at once.

        The previous chunk, which real-time chunking offers as guidance, is ignored. Consecutive
        chunks follow from one history and need none. The head's errors agree over a whole chunk, so
        guidance towards the first actions of the previous one would keep its outdated forecast.
        """
        config = self.config
        live = self.real_time or "prev_chunk_left_over" in kwargs
        self._note(batch, config.n_action_steps / config.embodiment.fps, live=live)
        return self._chunk(inference_delay)

    @on_one_thread
    @torch.no_grad()
    def observe(self, batch: Batch) -> None:
        """Add a frame to the history without acting, for callers that ask for chunks now and then.

        A frame is as old as its ``timestamp`` says, or, if the batch has none, a tick of
        ``embodiment.fps`` later than the one before, or, in `real_time`, as the wall clock says.
        """
        self._note(batch, 1 / self.config.embodiment.fps, live=self.real_time)

    def _note(self, batch: Batch, step_s: float, *, live: bool) -> None:
        """Add a frame that is, without ``timestamp``, ``step_s`` later than the one before, or, if
        the caller is ``live``, as old as the wall clock says, in ticks.

        LeRobot's real-time chunking hands over a frame twice if it asks faster than that: it counts
        once. After `reset` it hands over the last frame of the previous episode, which is forgotten
        when another one comes.
        """
        self.eval()
        now_s = time.monotonic() if live else self._now_s + step_s
        if live and "timestamp" not in batch:
            shown, old = (
                [batch[key].clone() for key in (*self.config.state_keys, *self.config.cameras)],
                self._shown,
            )
            same = old is not None and all(map(torch.equal, shown, old))
            if same and self._history:
                return
            if self._stale:
                self.reset()
            self._shown, self._stale = shown, same
            if self._history:
                fps = self.config.embodiment.fps
                ticks = round((now_s - self._began_s) * fps)
                now_s = max(self._began_s + ticks / fps, self._now_s + 1 / fps)
        self._see(batch, now_s)

    def _see(self, batch: Batch, time_s: float) -> None:
        """Encode the newest frame and keep it; it was seen at ``time_s`` if the batch does not say
        when.
        """
        model = self._actor
        images = {key: batch[key].to(model.action_mean) for key in self.config.cameras}
        state = model.state_of(batch).to(model.action_mean)
        if self._history and len(self._history[-1].state) != len(state):
            raise ValueError(
                f"the batch changed from {len(self._history[-1].state)} to {len(state)} "
                f"environments: call policy.reset() between."
            )
        self._now_s = float(batch["timestamp"].flatten()[0]) if "timestamp" in batch else time_s
        if not self._history:
            # single precision keeps differences of such times, not times of day
            self._began_s = self._now_s
        # the same by timestamps in single precision as by counting
        elapsed_s = round(self._now_s - self._began_s, 4)
        sightings = model.encode_images(images, before=self._images or images)
        self._images, self._frame = images, self._frame + 1
        seen = Frames(sightings[:, None], state[:, None], state.new_tensor([elapsed_s]))
        self._history.append(seen)

    def _chunk(self, inference_delay: int) -> Tensor:
        """Return the chunk for the newest frame, ``(B, H, A)``, that is there so many frames
        later.
        """
        model, frames = self._actor, _joined(self._history)
        # recorded actions, which begin now, were learned from where the palm is now
        waits = inference_delay if self.config.forecasts else 0
        palm = self._due(waits) if self.config.forecasts else frames.palm[:, -1]
        forecast = model.encode_history(frames)[:, 0].later(waits)
        state = frames.state[:, -1]
        context, origin = model.condition(forecast, palm, state)
        eyes, rays = model.forecaster.sighted(frames)
        seen, sighted = frames.sightings[:, -1], (eyes + rays)[:, -1]
        ahead_s = model.forecaster.ahead_s
        self.decision = Decision(
            seen, sighted, forecast.places, ahead_s, origin[:, 0], forecast.attention
        )
        chunk = model.unnormalise(model.head.sample(context, self._frame), origin).float()
        delay = min(waits, self.config.horizon - 1)
        past = chunk[:, :1].expand(-1, delay, -1)
        chunk = torch.cat([past, chunk[:, : self.config.horizon - delay]], dim=1)
        first = self._frame + delay
        old = {frame: goal for frame, goal in self._commands.items() if frame < first}
        self._commands = old | {
            self._frame + i: palm_of(chunk[:, i]) for i in range(delay, self.config.horizon)
        }
        return chunk

    def _due(self, inference_delay: int) -> Tensor:
        """Return where the palm will be when the next command takes effect [m], ``(B, 3)``.

        That follows from the commands on their way, cut to the palm's speed, as long as the palm
        does what it is told: where it should have moved and did not, as in an observation window,
        it is taken to stay.
        """
        palm, embodiment = self._history[-1].palm[:, 0], self.config.embodiment
        effective, coming = self._frame - embodiment.delay_frames, self._commands
        executed = coming.get(effective - 1)
        frames = range(effective, self._frame + inference_delay)
        if executed is None or len(self._history) < 2 or not frames:
            return palm
        before = self._history[-2].palm[:, 0]
        commanded_m = (stepped(before, executed, embodiment.step_m) - before).norm(dim=-1)
        moves, due = (palm - before).norm(dim=-1) > 0.5 * commanded_m, palm
        for frame in frames:
            goal = coming.get(min(frame, max(coming)))
            due = due if goal is None else stepped(due, goal, embodiment.step_m)
        return torch.where(moves[:, None], due, palm)

    # -- real-time chunking, adapters, checkpoints -------------------------------------------------

    def supports_rtc(self) -> bool:
        """Return True: `lerobot-rollout` may ask for the next chunk while the robot executes this
        one.
        """
        return True

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint; the weights that its encoders and head started from are not needed any
        more.
        """
        return super().from_pretrained(pretrained_name_or_path, load_pretrained=False, **kwargs)

    @classmethod
    def _load_as_safetensor(
        cls, model: Self, model_file: str, map_location: str, strict: bool
    ) -> Self:
        """Load weights. A policy that keeps no average, such as the base of an adapter, continues
        with the averaged weights, as `keep_average` does.
        """
        loaded = super()._load_as_safetensor(model, model_file, map_location, strict)
        if loaded.average is None:
            stored = load_file(model_file, device="cpu")
            averaged = {
                name.removeprefix(AVERAGED): weight
                for name, weight in stored.items()
                if name.startswith(AVERAGED)
            }
            if averaged:
                loaded.model.load_state_dict(averaged)
        return loaded

    def keep_average(self) -> None:
        """Continue with the averaged weights alone, which acted so far."""
        if self.average is not None:
            self.model.load_state_dict(self.average.module.state_dict())
            self.average, self.config.ema_decay = None, 0.0

    def wrap_with_peft(self, *args: Any, **kwargs: Any) -> PreTrainedPolicy:
        """Add adapters to the acting weights. Adapters are not averaged, so the average becomes the
        base.
        """
        self.keep_average()
        return super().wrap_with_peft(*args, **kwargs)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return {
            "target_modules": r"model\.forecaster\.blocks\..*\.(qkv|out)",
            "modules_to_save": [],
        }


def _joined(frames: Sequence[Frames]) -> Frames:
    """Return frames that were seen one after the other."""
    sightings, state = (
        torch.cat([getattr(frame, name) for frame in frames], dim=1)
        for name in ("sightings", "state")
    )
    return Frames(sightings, state, torch.cat([frame.time_s for frame in frames]))


# -- network ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Forecast(Record):
    """Where decisions, ``(B, Q)``, expect the target."""

    features: Tensor  # (B, Q, D)
    places: Tensor  # of the target [m], (B, Q, K, 3), see `FORECAST_FRAMES`
    # weights of the T frames of the history in the J positions read out, (B, Q, J, T)
    attention: Tensor | None = None

    def later(self, frames: int) -> Forecast:
        """Return it as it is so many frames later: for times that count from then."""
        times = torch.tensor(FORECAST_FRAMES, device=self.places.device)
        wanted = (times + frames).clamp_max(times[-1])
        high = torch.searchsorted(times, wanted).clamp_min(1)
        share = (wanted - times[high - 1]) / (times[high] - times[high - 1])
        before, after = self.places[..., high - 1, :], self.places[..., high, :]
        return replace(self, places=torch.lerp(before, after, share.to(before)[:, None]))


class ObActModel(nn.Module):
    """The network; ``config`` has its features and its embodiment filled in."""

    action_mean: Tensor
    action_std: Tensor
    state_mean: Tensor
    state_std: Tensor

    def __init__(self, config: ObActConfig) -> None:
        super().__init__()
        assert config.action_feature is not None
        assert config.input_features is not None
        n_actions, n_relative = config.action_feature.shape[0], config.relative_dims or 0
        n_state = sum(config.input_features[key].shape[0] for key in config.state_keys)
        self.config, self.n_relative = config, n_relative
        encoders = [
            ENCODERS[config.encoder](**_options(config.encoder_options, key))
            for key in config.cameras
        ]
        self.encoders = nn.ModuleList(encoders).requires_grad_(not config.freeze_encoder)
        self.forecaster = Forecaster(config, sum(encoder.embedding for encoder in encoders))
        self.features = nn.Linear(config.dim, N_FEATURES)
        n_inputs = n_state
        if config.forecasts:
            n_inputs = 4 * len(FORECAST_FRAMES) + (n_state - n_relative if config.grips else 0)
        self.trunk = nn.Sequential(
            perceptron(n_inputs + N_FEATURES, config.width, config.width), nn.SiLU()
        )
        if config.forecasts:
            n_places, n_axes = (2, 3) if config.grips else (1, 1)
            self.when = nn.Linear(
                config.width, config.horizon * n_axes * n_places * len(FORECAST_FRAMES)
            )
        groups = [size for size in (n_relative, n_actions - n_relative) if size]
        options = {"noise_seed": config.noise_seed} | config.head_options
        self.head = HEADS[config.head](config.width, config.horizon, groups, **options)
        for name, size in (("action", n_actions), ("state", n_state)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    def adopt_stats(self, stats: dict[str, dict[str, Any]]) -> None:
        """Take over LeRobot's statistics of the dataset; actions relative to the palm have mean
        0.
        """
        for name, keys in (("action", [ACTION]), ("state", self.config.state_keys)):
            if not keys:
                continue
            mean, std = (
                torch.cat(
                    [
                        torch.as_tensor(stats[key][moment], dtype=torch.float32).flatten()
                        for key in keys
                    ]
                )
                for moment in ("mean", "std")
            )
            getattr(self, f"{name}_mean").copy_(mean)
            getattr(self, f"{name}_std").copy_(std.clamp_min(1e-3))
        self.action_mean[: self.n_relative] = 0.0

    def load_pretrained(self) -> None:
        """Load the published weights that encoders and head name, if any."""
        for part in cast("list[Encoder]", [*self.encoders, self.head]):
            part.load_pretrained()

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.action_mean.device

    def state_of(self, batch: Batch) -> Tensor:
        """Return the vector observations of a batch, ``(..., S)``; S is 0 if there are none."""
        keys = self.config.state_keys
        if not keys:
            key = self.config.cameras[0]
            image = batch[key]
            return self.state_mean.new_zeros(*image.shape[:-3], 0)
        return torch.cat([batch[key] for key in keys], dim=-1)

    def encode_images(self, images: dict[str, Tensor], before: dict[str, Tensor]) -> Tensor:
        """Return what each camera saw, ``(F, C, 5 + E)``, in images ``(F, 3, H, W)``, RGB in [0,
        1].

        Those of the frame ``before`` only matter to encoders that see motion.
        """
        if self.config.sees_motion:
            images = {key: torch.cat([image, before[key]], dim=1) for key, image in images.items()}
        seen = [
            encoder(images[key])
            for encoder, key in zip(self.encoders, self.config.cameras, strict=True)
        ]
        return torch.stack(seen, dim=1)

    def encode_history(self, frames: Frames, rows: Tensor | None = None) -> Forecast:
        """Return the forecast of decisions at frames ``rows`` ``(B, Q)``; without ``rows``, of one
        at the last frame.
        """
        if rows is None:
            last = frames.state.shape[1] - 1
            rows = torch.full((len(frames.state), 1), last, device=frames.state.device)
        return self.forecaster(frames, rows)

    def condition(self, forecast: Forecast, palm: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return what the head reads, ``(R, C)``, and the places from which its actions count [m],
        ``(R, H, 3)``.

        Attention over the times of the forecast, whose values are positions, picks where to meet
        the target. To grip it, attention picks along each axis between the forecast and the places
        of a palm that moves along with the target. Without a forecast the actions count from the
        palm.

        Args:
            forecast: of R decisions, ``(R, ...)``.
            palm: where the palm will be when a command takes effect [m], ``(R, 3)``.
            state: of the robot, ``(R, S)``; with a forecast the head reads of it the joints, to
                grip, or nothing.
        """
        features, places = nn.functional.silu(self.features(forecast.features)), forecast.places
        state = (state - self.state_mean) / self.state_std
        if not self.config.forecasts:
            context = self.trunk(torch.cat([state, features], dim=-1))
            return context, repeat(palm, "r i -> r h i", h=self.config.horizon)
        unit = OFFSET_M + OFFSET_M_S * self.forecaster.ahead_s
        offset = (places - palm[:, None]) / unit[:, None]  # (R, K, 3)
        distance = offset.norm(dim=-1).clamp_max(FAR)
        joints = state[:, self.n_relative :] if self.config.grips else state[:, :0]
        context = self.trunk(
            torch.cat([offset.clamp(-FAR, FAR).flatten(1), distance, features, joints], dim=-1)
        )
        when, horizon = self.when(context), self.config.horizon
        if not self.config.grips:
            return context, rearrange(when, "r (h k) -> r h k", h=horizon).softmax(-1) @ places
        along = palm[:, None] + places - places[:, :1]
        when = rearrange(when, "r (h i k) -> r h i k", h=horizon, i=3).softmax(-1)
        return context, einsum(when, torch.cat([places, along], dim=1), "r h i k, r k i -> r h i")

    def act_once(self, forecast: Forecast, palm: Tensor, state: Tensor) -> Tensor:
        """Return actions ``(R, A)`` sampled in one step from fresh noise, for training; see
        `condition`.
        """
        context, origin = self.condition(forecast, palm, state)
        start = torch.randn(len(context), *self.head.noise_shape, device=context.device)
        return self.unnormalise(self.head.denoise(context, start, 1), origin)[:, 0]

    def normalise(self, actions: Tensor, origin: Tensor) -> Tensor:
        """Map actions ``(R, H, A)`` to what the head predicts; they count from ``origin`` ``(R, H,
        3)``.
        """
        return (actions - self._offset(origin)) / self.action_std

    def unnormalise(self, predicted: Tensor, origin: Tensor) -> Tensor:
        """Invert `normalise`."""
        return predicted * self.action_std + self._offset(origin)

    def _offset(self, origin: Tensor) -> Tensor:
        n = self.n_relative
        return nn.functional.pad(origin[..., :n], (0, len(self.action_mean) - n)) + self.action_mean


class Forecaster(nn.Module):
    """Tokens of frames, causal attention over them, and a forecast that combines positions sighted
    earlier.

    Args:
        config: with the embodiment filled in.
        n_extra: numbers of a token beside those of the sightings.
    """

    ahead_s: Tensor

    def __init__(self, config: ObActConfig, n_extra: int) -> None:
        super().__init__()
        dim, n_points, k = config.dim, config.n_points, len(FORECAST_FRAMES)
        known = [config.embodiment.calibration.get(key, UNCALIBRATED) for key in config.cameras]
        self.n_points = n_points
        cameras = nn.ModuleList(Pinhole.from_pose(x[:7], x[7], carried=bool(x[8])) for x in known)
        self.cameras = cast("list[Pinhole]", cameras)
        self.register_buffer(
            "ahead_s", torch.tensor(FORECAST_FRAMES) / config.embodiment.fps, persistent=False
        )
        self.token = perceptron(3 + 6 * len(known) + n_extra, dim, dim)
        self.blocks = nn.ModuleList(
            TemporalBlock(dim, config.n_heads) for _ in range(config.n_layers)
        )
        self.norm = nn.LayerNorm(dim)
        if n_points:
            self.readout = PositionReadout(dim, n_points)
            self.linear = nn.Linear(3 * n_points, 3 * k, bias=False)
            nn.init.zeros_(self.linear.weight)
        else:
            self.now = nn.Linear(dim, 3)
        last = nn.Linear(256, 3 * k)
        nn.init.zeros_(last.weight)
        self.bend = nn.Sequential(perceptron(dim + 3 * n_points, 256, 256), nn.SiLU(), last)

    def forward(self, frames: Frames, rows: Tensor) -> Forecast:
        """Return the forecast of decisions at frames ``rows`` ``(B, Q)``, each from the frames up
        to its own.
        """
        hidden, (eyes, rays) = frames.hidden, self.sighted(frames)
        scales = frames.sightings[..., 3:N_SIGHTING]
        position = fused(eyes, rays, scales)
        origin = position[:, :1] if hidden is None else _first_seen(position, hidden)
        extra = frames.sightings[..., N_SIGHTING:].flatten(2)
        seen = [
            scales.clamp(-6, 3) / 3,
            scales[..., :1].clamp_max(2).exp(),
            (rays / RAY_M).clamp(-FAR, FAR),
        ]
        place = ((position - origin) / PLACE_M).clamp(-FAR, FAR)
        tokens = self.token(torch.cat([place, torch.cat(seen, dim=-1).flatten(2), extra], dim=-1))
        age_s = frames.time_s[:, None] - frames.time_s  # (T, T), negative ahead
        for block in self.blocks:
            tokens = block(tokens, age_s, hidden)
        tokens = self.norm(tokens)
        chosen = repeat(rows, "b q -> b q d", d=tokens.shape[-1])
        features, points, attention = tokens.gather(1, chosen), None, None
        if self.n_points:
            points, attention = self.readout(tokens, position - origin, age_s, rows, hidden)
        return Forecast(features, self._places(features, points) + origin[:, :, None], attention)

    def sighted(self, frames: Frames) -> tuple[Tensor, Tensor]:
        """Return where the cameras are, and where from there they see the target [m], ``(B, T, C,
        3)`` each.
        """
        eyes = [cam.origin(frames.palm) + cam.pos for cam in self.cameras]
        rays = [
            cam.place(frames.sightings[:, :, i, :3]) - cam.pos for i, cam in enumerate(self.cameras)
        ]
        return torch.stack(eyes, dim=2), torch.stack(rays, dim=2)

    def _places(self, decisions: Tensor, points: Tensor | None) -> Tensor:
        """Combine the positions read out, ``(B, Q, J, 3)``, linearly, and bend the result by what
        the tokens say.
        """
        if points is None:
            base, features = PLACE_M * self.now(decisions)[:, :, None], decisions
        else:
            anchor = points[:, :, :1]
            differences = rearrange((points - anchor) / POINT_M, "b q j i -> b q (j i)")
            base = anchor + POINT_M * rearrange(
                self.linear(differences), "b q (k i) -> b q k i", i=3
            )
            features = torch.cat([decisions, differences.clamp(-FAR, FAR)], dim=-1)
        bend = rearrange(self.bend(features), "b q (k i) -> b q k i", i=3)
        return base + bend * (BEND_M + BEND_M_S * self.ahead_s)[:, None]


def fused(eyes: Tensor, rays: Tensor, scales: Tensor) -> Tensor:
    """Return where the cameras together place the target [m], ``(B, T, 3)``: each counts by what it
    is sure of.

    A camera's error is taken to be Gaussian with the ``scales`` ``(B, T, C, 2)`` it reports, across
    and along its line of sight, so the lines of sight of two cameras cross where both are precise.
    See `Forecaster.sighted` for the others.
    """
    if eyes.shape[2] == 1:
        return (eyes + rays)[:, :, 0]
    distance = rays.norm(dim=-1, keepdim=True).clamp_min(1e-3)
    sight = rays / distance
    across, along = ((scales.clamp(-6, 2).exp() * distance).clamp_min(1e-3) ** -2)[
        ..., None
    ].unbind(-2)  # (B, T, C, 1)
    line = einsum(sight, sight, "... i, ... j -> ... i j")
    precise = (
        across[..., None] * (torch.eye(3, device=line.device) - line) + along[..., None] * line
    )
    return torch.linalg.solve(precise.sum(2), (precise @ (eyes + rays)[..., None]).sum(2))[..., 0]


def _first_seen(position: Tensor, hidden: Tensor) -> Tensor:
    """Return positions ``(B, T, 3)`` in the first frames that are not ``hidden``, ``(B, 1, 3)``."""
    return gather_frames(position, hidden.int().argmin(1)[:, None])


def _options(options: dict[str, Any], camera: str) -> dict[str, Any]:
    """Return the options of the encoder for an image key, whose last part is the ``{view}`` in a
    text.
    """
    view = camera.rsplit(".", maxsplit=1)[-1]
    return {
        name: x.replace("{view}", view) if isinstance(x, str) else x for name, x in options.items()
    }
