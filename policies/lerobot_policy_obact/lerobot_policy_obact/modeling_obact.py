"""ObAct in LeRobot: the policy that is trained and acts. Its network is in `network`.

`ObActPolicy.forward` is the only loss; `ObActPolicy.select_action` asks the network for a chunk of
actions when the last one is used up.
"""

from __future__ import annotations

import time
from collections import deque
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor

from .commands import CommandBuffer
from .configuration_obact import ObActConfig
from .frames import Frames, ObservationHistory, palm_of, stepped
from .network import Batch, ObActModel
from .threads import on_one_thread

# modules that can read where the target is are imported only by the functions that train, so that
# what acts cannot reach them
if TYPE_CHECKING:
    from .dataset import TargetTable
    from .forecaster import Forecast

OVERSHOOT = 0.01  # by which a resize may leave the range of images, [0, 1]
TIMESTAMP = "timestamp"
"""Key of the time at which a frame was seen [s]."""


class Decision(NamedTuple):
    """What the newest decision of B environments was based on, for whoever draws it."""

    sightings: Tensor  # in the newest images, by camera, (B, C, 5 + E), see `Frames`
    sighted: Tensor  # where that is [m], (B, C, 3)
    forecast: Tensor  # of the target [m], (B, K, 3)
    ahead_s: Tensor  # when it is expected there, from now [s], (K,)
    intercept: Tensor  # where the palm is to meet it [m], (B, 3)
    # weights of the T frames of the history, oldest first, in J readouts, (B, J, T)
    attention: Tensor


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
    """Whether the world moves on while a caller who asks for chunks waits: the wall clock then
    stamps frames without ``timestamp``."""
    _shown: Batch | None = None  # what was observed last, also before `reset`

    def __init__(
        self,
        config: ObActConfig,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any | None = None,
        load_pretrained: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(config)
        self.targets: TargetTable | None = None
        if dataset_meta is None:
            config.validate_features()
        else:
            from .dataset import adopt

            self.targets = adopt(config, dataset_meta)
        self.model = ObActModel(config)
        if load_pretrained:
            self.model.load_pretrained()
        if dataset_stats is not None:
            self.model.adopt_stats(dataset_stats)
        self.reset()

    # -- training ----------------------------------------------------------------------------------

    def forward(self, batch: Batch, reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a preprocessed batch, and what to log.

        ``reduction`` is "mean" for a scalar, "none" for one loss per sample, ``(B,)``.
        """
        from .losses import window_losses
        from .windows import VirtualHands, Window

        config = self.config
        table = self.targets
        window = Window.of(batch, self.model, table, self._drawn_inference_delay())
        if table is not None:
            hands = VirtualHands(table.teacher, self.model)
            virtual_share = config.virtual_share if self.training else 0.0
            window = hands.drawn(window.repeated(config.n_hands), virtual_share)
        losses = window_losses(self.model, window, table and table.teacher)
        logged = {name: float(loss.detach().mean()) for name, loss in losses.items()}
        weights = {
            "forecast": config.forecast_weight,
            "closed_loop": config.closed_loop_weight,
        }
        weighted = [weights.get(name, 1.0) * loss for name, loss in losses.items()]
        total = torch.stack(weighted).sum(0)
        if table is not None:
            weight = table.weight[batch["episode_index"].flatten().cpu()].to(total)
            total = total * weight.repeat_interleave(config.n_hands)
        if reduction == "none":
            return total.unflatten(0, (len(batch[ACTION]), -1)).mean(1), logged
        return total.mean(), logged

    def _drawn_inference_delay(self) -> int:
        """Return how many frames inference takes in this step of the training: 0, or, in
        `delayed_share` of the steps, up to ``horizon - 1``. Recorded actions alone are learned as
        if it took none.
        """
        config = self.config
        # a share of 0 draws no random number, so that the others stay the same
        draws = self.training and config.horizon > 1 and config.delayed_share > 0
        if self.targets is None or not draws or torch.rand(()) >= config.delayed_share:
            return 0
        return int(torch.randint(1, config.horizon, ()))

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Return parameter groups: weight decay for matrices and tables, none for vectors."""
        trained = [p for p in self.model.parameters() if p.requires_grad]
        return [
            {"params": [p for p in trained if p.dim() >= 2]},
            {"params": [p for p in trained if p.dim() < 2], "weight_decay": 0.0},
        ]

    # -- acting ------------------------------------------------------------------------------------

    @property
    def _actor(self) -> ObActModel:
        """The network that acts until the next reset, in double precision.

        The last digits of a network depend on the size of the batch, on threads and on the
        processor, and an edge that moves by a pixel makes them grow. Actions that are rounded to
        single precision do not depend on them.
        """
        if not self._actors:
            exact = self.config.exact
            self._actors.append(deepcopy(self.model).double() if exact else self.model)
        return self._actors[0]

    def reset(self) -> None:
        """Forget the last episode."""
        self._actors: list[ObActModel] = []  # in a list, or PyTorch would save it with the weights
        self._history = ObservationHistory(self.config.history_steps, self.config.embodiment.fps)
        self._stale = False  # whether the only frame seen is the last one of the episode before
        self._action_queue: deque[Tensor] = deque()
        self._commands = CommandBuffer(self.config.embodiment)
        self.decision: Decision | None = None  # the newest

    @on_one_thread
    @torch.no_grad()
    def select_action(self, batch: Batch, **kwargs: Any) -> Tensor:
        """Return the next action of every environment, ``(B, A)``; call it once per control step.

        A frame is stamped with its ``timestamp``, that of the first environment for all, or,
        without one, a tick of ``embodiment.fps`` after the one before. While actions are queued, a
        frame that is shown again counts once: the world stands still until they have been read.
        """
        self.eval()
        if not (self._action_queue and self._is_shown_again(batch)):
            self._see(batch, self._history.now_s + 1 / self.config.embodiment.fps)
        if not self._action_queue:
            config = self.config
            # and more, which are executed while the next chunk is computed
            n_actions = config.n_action_steps + config.inference_delay
            chunk = self._chunk(config.inference_delay, n_actions)
            self._action_queue.extend(chunk[:, : config.n_action_steps].unbind(1))
        return self._action_queue.popleft()

    def keep_rows(self, rows: Any) -> bool:
        """Go on with the environments of the sorted rows ``(R,)`` of the batch alone, and return
        True; False, and nothing changes, if rounding makes what they do depend on the others.
        """
        if not self.config.exact:
            return False
        self._history.keep_rows(rows)
        self._commands.keep_rows(rows)
        self._action_queue = deque(actions[rows] for actions in self._action_queue)
        if self._shown is not None:
            self._shown = {
                key: x if key == TIMESTAMP else x[rows] for key, x in self._shown.items()
            }
        return True

    @on_one_thread
    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch, inference_delay: int = 0, **kwargs: Any) -> Tensor:
        """Return a whole chunk, ``(B, H, A)``.

        A frame is stamped with its ``timestamp``, or, without one, ``n_action_steps`` ticks after
        the one before, as in a simulation that waits. In `real_time`, and if a previous chunk is
        offered, as by LeRobot's real-time chunking, the wall clock stamps it.

        The first ``inference_delay`` actions have expired when the chunk arrives: they repeat those
        of the chunk before. The others follow from the forecast and from where the palm will be by
        then, or, without a forecast, are those expected of a hand that acts at once.

        The previous chunk, which real-time chunking offers as guidance, is ignored. Consecutive
        chunks follow from one history and need none. The head's errors agree over a whole chunk, so
        guidance towards the first actions of the previous one would keep its outdated forecast.
        """
        config = self.config
        live = self.real_time or "prev_chunk_left_over" in kwargs
        if inference_delay < 0:
            raise ValueError(f"inference_delay is {inference_delay}, but must be 0 or more.")
        self._note(batch, config.n_action_steps / config.embodiment.fps, live=live)
        return self._chunk(inference_delay, config.horizon)

    @on_one_thread
    @torch.no_grad()
    def observe(self, batch: Batch) -> None:
        """Add a frame to the history without acting, for callers that ask for chunks now and then.

        A frame is stamped with its ``timestamp``, or, without one, a tick of ``embodiment.fps``
        after the one before, or, in `real_time`, by the wall clock.
        """
        self._note(batch, 1 / self.config.embodiment.fps, live=self.real_time)

    def _note(self, batch: Batch, step_s: float, *, live: bool) -> None:
        """Add a frame. Without ``timestamp``, it is ``step_s`` later than the one before, or, if
        the caller is ``live``, at the tick of the wall clock.
        """
        self.eval()
        now_s = time.monotonic() if live else self._history.now_s + step_s
        if live and TIMESTAMP not in batch:
            # LeRobot's real-time chunking asks faster than frames come, and after a reset it shows
            # the last frame of the episode before: the policy acts on that, and forgets it when
            # another frame comes, with which the episode begins
            again = self._is_shown_again(batch)
            if again and self._history.ticks:
                return
            if self._stale:
                self.reset()
            self._stale = again
            if self._history.ticks:
                now_s = self._history.next_tick_s(now_s)
        self._see(batch, now_s)

    def _is_shown_again(self, batch: Batch) -> bool:
        """Whether a batch is the one that was shown last."""
        shown = self._shown
        seen = self._observed(batch)
        if shown is None or shown.keys() != seen.keys():
            return False
        return all(torch.equal(x, seen[key]) for key, x in shown.items())

    def _observed(self, batch: Batch) -> Batch:
        """Return what a batch holds of a frame: state, images, and when it was seen, if it says.

        A batch has one clock: the ``timestamp`` of environment 0 is taken for all of them.
        """
        keys = (*self.config.state_keys, *self.config.cameras)
        seen = {key: torch.as_tensor(batch[key]) for key in keys if key in batch}
        if TIMESTAMP in batch:
            seen[TIMESTAMP] = torch.as_tensor(batch[TIMESTAMP]).flatten()[0]
        return seen

    def _see(self, batch: Batch, time_s: float) -> None:
        """Encode the newest frame and keep it; it was seen at ``time_s`` if the batch does not say
        when.

        Raises:
            ValueError: if an input is missing or has another shape or range than in training, if
                the number of environments has changed, or if time goes back.
        """
        model = self._actor
        cameras = self.config.cameras
        self._check_inputs(batch)
        before = self._shown if self._shown and self._history.ticks else batch
        known = len(before[cameras[0]])
        given = len(batch[cameras[0]])
        if known != given:
            raise ValueError(
                f"the batch changed from {known} to {given} environments: call policy.reset() "
                "between."
            )
        sightings = model.encode_images(batch, before)
        state = model.state_of(batch, sightings.shape[:1])
        shown = {key: x.clone() for key, x in self._observed(batch).items()}
        self._history.add(sightings, state, float(shown.get(TIMESTAMP, time_s)))
        self._shown = shown

    def _check_inputs(self, batch: Batch) -> None:
        """Refuse what the network would take for something else."""
        config = self.config
        features = config.input_features or {}
        first = config.cameras[0]
        for key in (*config.cameras, *config.state_keys):
            x = batch.get(key)
            shape = tuple(features[key].shape)
            if not isinstance(x, Tensor) or x.shape[1:] != shape:
                found = f"of shape {tuple(x.shape)}" if isinstance(x, Tensor) else type(x)
                wanted = ", ".join(map(str, ("B", *shape)))
                raise ValueError(
                    f"{key} is {'missing' if x is None else found}, but must be a tensor of shape "
                    f"({wanted})."
                )
            if len(x) != len(batch[first]):
                raise ValueError(
                    f"{key} is of {len(x)} environments, but must be of {len(batch[first])}, as "
                    f"{first} is."
                )
            in_range = (x >= -OVERSHOOT) & (x <= 1 + OVERSHOOT)
            if key in config.cameras and not (x.is_floating_point() and in_range.all()):
                raise ValueError(
                    f"{key} is {x.dtype} from {x.min():g} to {x.max():g}, but must be floating "
                    "point in [0, 1]."
                )

    def _chunk(self, inference_delay: int, n_actions: int) -> Tensor:
        """Return the first actions of the chunk for the newest frame, ``(B, n_actions, A)``, that
        is there ``inference_delay`` frames later.
        """
        model = self._actor
        frames = self._history.frames()
        forecast = model.encode_history(frames)[:, 0]
        if self.config.forecasts:
            actions, origin = self._act_ahead(forecast, frames, inference_delay, n_actions)
        else:  # recorded actions were learned from where the palm is now
            actions, origin = self._decide(forecast, frames.palm[:, -1], frames.state[:, -1])
            actions = actions[:, :n_actions]
        centers, rays = model.forecaster.sighted(frames)
        self.decision = Decision(
            sightings=frames.sightings[:, -1],
            sighted=(centers + rays)[:, -1],
            forecast=forecast.places,
            ahead_s=model.forecaster.ahead_s,
            intercept=origin[:, 0],
            attention=forecast.attention,
        )
        return self._commands.give(actions, self._history.ticks[-1], inference_delay)

    def _decide(self, forecast: Forecast, palm: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the chunk that the head samples, ``(B, H, A)``, and the places that its actions
        are relative to, ``(B, H, 3)``; see `ObActModel.condition`.
        """
        model = self._actor
        context, origin = model.condition(forecast, palm, state)
        chunk = model.unnormalize(model.head.sample(context, self._history.ticks[-1]), origin)
        return chunk.float(), origin

    def _act_ahead(
        self, forecast: Forecast, frames: Frames, inference_delay: int, n_actions: int
    ) -> tuple[Tensor, Tensor]:
        """Return actions for the newest frame and those after it, ``(B, n_actions, A)``, and the
        places that those of the first decision are relative to, ``(B, H, 3)``.

        As in the closed loop of the training, each is the first action of a decision of its own,
        from the forecast and the palm as of the frame in which it takes effect. The first decision
        is for the frame in which inference ends, and stands for those before.
        """
        embodiment = self.config.embodiment
        palm = self._commands.expected_palm(frames.palm, self._history.ticks, inference_delay)
        effective = inference_delay + embodiment.delay_frames
        decided = []
        for ahead in range(max(1, n_actions - inference_delay)):
            chunk, origin = self._decide(
                forecast.later(effective + ahead), palm, frames.state[:, -1]
            )
            decided.append((chunk[:, 0], origin))
            palm = stepped(palm, palm_of(chunk[:, 0]), embodiment.step_m)
        actions = [action for action, _ in decided]
        before = [actions[0]] * min(inference_delay, n_actions - 1)
        return torch.stack([*before, *actions], dim=1), decided[0][1]

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

    def _get_default_peft_targets(self) -> dict[str, Any]:
        targets = r"model\.forecaster\.blocks\..*\.(qkv|out)"
        return {"target_modules": targets, "modules_to_save": []}
