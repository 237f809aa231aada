"""ObAct in LeRobot: what is trained and what acts.

`ObActPolicy.forward` is the only loss. `ObActPolicy.select_action` asks the network (`network`) for
a chunk of actions when the last one is used up.
"""

from __future__ import annotations

import time
from collections import deque
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, cast

import torch
from einops import rearrange
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from safetensors.torch import load_file
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from .attention import Memory
from .belief import Frames, palm_of, stepped
from .configuration_obact import ObActConfig
from .encoders import N_SIGHTING
from .network import ObActModel
from .threads import on_one_thread

if TYPE_CHECKING:
    from .decisions import Episodes
    from .recordings import Recordings
    from .teacher import Teacher
    from .virtual_episodes import VirtualEpisodes

AVERAGED = "average.module."
"""Names of averaged weights begin so in a file."""
Batch = dict[str, Any]


class Thought(NamedTuple):
    """What the newest decision of B environments saw and expects, for whoever draws it."""

    sightings: Tensor  # in the newest images, by camera, (B, C, 5 + E), see `Frames`
    sighted: Tensor  # where that is [m], (B, C, 3)
    forecast: Tensor  # of the target [m], (B, K, 3)
    ahead_s: Tensor  # when it is expected there, from now [s], (K,)
    meeting: Tensor  # where the palm is to meet it [m], (B, 3)
    weights: (
        Tensor | None
    )  # of the S frames observed so far, oldest first, in J readouts, (B, J, S)


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
        self._meta = dataset_meta
        if dataset_meta is not None:
            from .recordings import describe, rules_of

            config.rules = rules_of(dataset_meta)
            knew, config.rig = config.forecasts, describe(dataset_meta, config.cameras)
            if config.pretrained_path and knew and not config.forecasts:
                raise ValueError(
                    f"{config.pretrained_path} learned from the target's path, which "
                    f"{dataset_meta.repo_id} lacks; "
                    "train from random weights, or record with dynahoi generate --actor"
                )
            if (
                config.forecasts and config.input_features
            ):  # it reads no other vectors, which a robot may not have
                read = {*config.cameras, OBS_STATE}
                config.input_features = {
                    key: x for key, x in config.input_features.items() if key in read
                }
        self.model = ObActModel(config)
        if load_pretrained:
            self.model.load_pretrained()
        if dataset_stats is not None:
            self.model.adopt_stats(dataset_stats)
        self.average = AveragedModel(self.model).requires_grad_(False) if config.ema_decay else None
        self.recordings: Recordings | None = None
        self.virtual: VirtualEpisodes | None = None
        self.reset()

    # -- training ----------------------------------------------------------------------------------

    def forward(self, batch: Batch, reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a preprocessed batch, and what to log.

        With a frozen encoder a sample stands for ``episodes_per_sample`` episodes: for decisions in
        them, and, where the target's path is known, for a palm that is rolled out. Else it is one
        decision of a window of images. ``reduction`` is "mean" for a scalar, "none" for one loss
        per sample, ``(B,)``.
        """
        from .decisions import episode_losses, window_losses

        model, config = self.model if self.training else self.acting, self.config
        if config.freeze_encoder:
            losses = episode_losses(model, *self._episodes(batch["episode_index"].flatten().cpu()))
        else:
            losses = window_losses(model, batch)
        weights = {
            "forecast": config.forecast_weight,
            "action": config.action_weight,
            "missed": config.action_weight,
            "closed_loop": config.closed_loop_weight,
        }
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum(0)
        logged = {name: float(loss.mean()) for name, loss in losses.items()}
        if reduction == "none":
            return rearrange(total, "(b e) -> b e", b=len(batch[ACTION])).mean(1), logged
        return total.mean(), logged

    def _episodes(self, named: Tensor) -> tuple[Episodes, Teacher | None]:
        """Return the episodes that a batch names, or, in training, as many times others of those
        known so far.
        """
        from .recordings import Recordings
        from .virtual_episodes import VirtualEpisodes

        if self.recordings is None:
            self.recordings = Recordings.encoded(self._meta, self.config, self.acting)
            described = (
                self.recordings.episodes.sightings.shape[-1] > N_SIGHTING
            )  # by what no virtual hand sees
            if self.recordings.teacher is not None and not described:
                self.virtual = VirtualEpisodes(self.recordings, self.acting.belief.cameras)
        recordings, n = self.recordings, len(named) * self.config.episodes_per_sample
        if not self.training:
            return recordings.episodes[named], recordings.teacher
        recordings.named[named] = (
            True  # LeRobot may select episodes and hold others out; batches tell which
        )
        if self.virtual is not None and torch.rand(()) < self.config.virtual_share:
            return self.virtual.draw(n, self.acting), recordings.teacher
        return recordings.draw(n), recordings.teacher

    def update(self) -> None:
        """Update the averaged weights after an optimiser step; random first weights are soon
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
        self._memory, self._outlook = Memory(), None
        self._frames: deque[Frames] = deque(maxlen=2)
        self._frame = -1  # the number of the newest one
        self._began_s = self._now_s = 0.0  # when the first and the newest one were seen
        self._images: dict[str, Tensor] = {}
        self._stale = False  # whether the only frame is the last one of the episode before
        self._queue: deque[Tensor] = deque()
        self._sent: deque[Tensor] = deque(maxlen=self.config.rig.delay_frames + 1)
        self.thought: Thought | None = None  # the newest decision

    @on_one_thread
    @torch.no_grad()
    def select_action(self, batch: Batch, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, ``(B, A)``; call it once per control step.

        A frame is as old as its ``timestamp`` says, or, if the batch has none, as calls at
        ``rig.fps`` say.
        """
        self.eval()
        self._see(batch, self._now_s + 1 / self.config.rig.fps)
        if not self._queue:
            self._queue.extend(self._chunk()[:, : self.config.n_action_steps].unbind(1))
        action = self._queue.popleft()
        self._sent.append(palm_of(action))
        return action

    @on_one_thread
    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch, **kwargs: Any) -> Tensor:
        """Return a whole chunk, ``(B, H, A)``; see `observe`.

        The previous chunk, which real-time chunking offers as guidance, is ignored. Consecutive
        chunks follow from one history and need none. The head's errors agree over a whole chunk, so
        guidance towards the first actions of the previous one would keep its outdated forecast.
        """
        self.observe(batch)
        return self._chunk()

    @on_one_thread
    @torch.no_grad()
    def observe(self, batch: Batch) -> None:
        """Add a frame to the history without acting, for callers that ask for chunks now and then.

        A frame is as old as its ``timestamp`` says, or, if the batch has none, as the wall clock
        says, in ticks of ``rig.fps``. LeRobot's real-time chunking hands over a frame twice if it
        asks faster than that: it counts once. After `reset` it hands over the last frame of the
        previous episode, which is forgotten when another one comes.
        """
        self.eval()
        now_s = time.monotonic()
        if "timestamp" not in batch:
            shown, old = (
                [batch[key].clone() for key in (*self.config.state_keys, *self.config.cameras)],
                self._shown,
            )
            same = old is not None and all(map(torch.equal, shown, old))
            if same and self._frames:
                return
            if self._stale:
                self.reset()
            self._shown, self._stale = shown, same
            if self._frames:
                fps = self.config.rig.fps
                ticks = round((now_s - self._began_s) * fps)
                now_s = max(self._began_s + ticks / fps, self._now_s + 1 / fps)
        self._see(batch, now_s)

    def _see(self, batch: Batch, time_s: float) -> None:
        """Encode the newest frame and keep it; it was seen at ``time_s`` if the batch does not say
        when.
        """
        model, config = self._actor, self.config
        images = {key: batch[key].to(model.action_mean) for key in config.cameras}
        state = torch.cat([batch[key] for key in config.state_keys], dim=-1).to(model.action_mean)
        if self._frames and (n := len(self._frames[-1].state)) != len(state):
            raise ValueError(
                f"the batch changed from {n} to {len(state)} environments: call policy.reset() "
                f"between."
            )
        self._now_s = float(batch["timestamp"].flatten()[0]) if "timestamp" in batch else time_s
        if not self._frames:
            self._began_s = (
                self._now_s
            )  # single precision keeps differences of such times, not times of day
        elapsed_s = round(
            self._now_s - self._began_s, 4
        )  # the same by timestamps in single precision as by counting
        sightings = model.encode_images(images, before=self._images or images)
        self._images = images
        self._frames.append(
            Frames(sightings[:, None], state[:, None], state.new_tensor([elapsed_s]))
        )
        self._frame += 1
        self._outlook = model.encode_history(self._frames[-1], memory=self._memory)

    def _chunk(self) -> Tensor:
        """Return the chunk for the newest frame, ``(B, H, A)``."""
        assert self._outlook is not None
        model, frame, outlook = self._actor, self._frames[-1], self._outlook[:, 0]
        context, origin = model.condition(outlook, self._due(), frame.state[:, 0])
        eyes, rays = model.belief.sighted(frame)
        seen, sighted = frame.sightings[:, 0], (eyes + rays)[:, 0]
        self.thought = Thought(
            seen, sighted, outlook.forecast, model.belief.ahead_s, origin[:, 0], outlook.weights
        )
        return model.unnormalise(model.head.sample(context, self._frame), origin).float()

    def _due(self) -> Tensor:
        """Return where the palm will be when the next command takes effect [m], ``(B, 3)``.

        That follows from the commands on their way, cut to the palm's speed, as long as the palm
        does what it is told: where it should have moved and did not, as in an observation window,
        it is taken to stay. A caller of `predict_action_chunk` may have executed other commands, so
        there a palm in motion is taken to go on.
        """
        palm, rig = self._frames[-1].palm[:, 0], self.config.rig
        if not rig.delay_frames or len(self._frames) < 2:
            return palm
        before = self._frames[0].palm[:, 0]
        if not self._sent:
            elapsed_s = max(1e-3, float(self._frames[1].time_s - self._frames[0].time_s))
            return palm + (palm - before) / elapsed_s * rig.delay_frames / rig.fps
        executed, *coming = self._sent
        if len(coming) < rig.delay_frames:
            return palm
        commanded_m = (stepped(before, executed, rig.step_m) - before).norm(dim=-1)
        moves, due = (palm - before).norm(dim=-1) > 0.5 * commanded_m, palm
        for goal in coming:
            due = stepped(due, goal, rig.step_m)
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
        return {"target_modules": r"model\.belief\.blocks\..*\.(qkv|out)", "modules_to_save": []}
