"""Configuration of ObAct, ``--policy.type=obact``."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig, CosineDecayWithWarmupSchedulerConfig
from lerobot.policies.rtc import RTCConfig

from .attention import MEMORY_FRAMES
from .encoders import ENCODERS
from .gr00t_head import Gr00tHead
from .heads import ActionHead, DiffusionDenoiser, FlowDenoiser

MAX_SAMPLING = 100  # most steps, and most draws, of a head
HEADS: dict[str, Callable[..., Any]] = {
    "diffusion": partial(ActionHead, DiffusionDenoiser),
    "flow": partial(ActionHead, FlowDenoiser),
    "regression": partial(ActionHead, None),
    "gr00t": Gr00tHead,
}
CONTACT = "contact"
"""The rule of capture under which targets must be gripped; under all others the palm has to come
near enough."""
WINDOW_FRAMES = 5  # frames before the current one that LeRobot loads where a decision is to see all


@dataclass(frozen=True)
class Rig:
    """What a dataset says of the robot that it was recorded with, and of its task."""

    fps: float = 20.0  # frame rate [Hz]
    calibration: dict[str, list[float]] = field(default_factory=dict)
    """Of each camera: pose from the palm (position [m], quaternion wxyz), tangent of half the field
    of view, and 1 if the palm carries it, else 0. A camera without one sees rays of unit depth."""
    delay_frames: int = 0  # control steps from a command to its effect
    palm_speed_m_s: float = 0.0  # the palm's speed limit
    capture: str = ""  # the rule of capture; empty where the target's path is not known
    radius_m: float = 0.03  # within which the palm has the target, unless it must be gripped

    @property
    def step_m(self) -> float:
        """How far a palm gets in a frame [m]."""
        return self.palm_speed_m_s / self.fps


@PreTrainedConfig.register_subclass("obact")
@dataclass
class ObActConfig(PreTrainedConfig):
    """Observe before act (DynaHOI, Section 4): what was observed conditions a generative action
    head.

    The defaults are those of a dataset of DynaHOI. For others, `README.md` says what to change.
    """

    n_obs_frames: int | None = None
    """Observed frames before the current one, the paper's ``s``; 0 is the single-frame control,
    None all of the last ten seconds."""
    obs_stride: int = 1  # distance between observed frames [frames]
    horizon: int = 8  # actions in a predicted chunk, ``H``
    n_action_steps: int = 1  # actions of a chunk that are executed before the policy replans
    relative_dims: int = 3
    """Leading entries of an action that say where to go in the frame of the same entries of
    ``observation.state`` [m]; they are predicted as displacements. 0 for actions of another
    kind."""

    encoder: str = "eye"  # one of `ENCODERS`
    encoder_options: dict[str, Any] = field(default_factory=lambda: {"weights": "{view}_96"})
    """Keyword options of that encoder. In a text, ``{view}`` stands for the last part of the key of
    the image, so that each camera may start from weights of its own."""
    freeze_encoder: bool = True
    """Whether training leaves its weights alone. All images are then encoded before training
    begins, which reads no others; with a dataset that holds the target's path, it also shows
    virtual hands."""
    cache_images: bool = True  # whether encoded images are kept on disk for the next run
    head: str = "diffusion"  # one of `HEADS`
    head_options: dict[str, Any] = field(default_factory=dict)  # keyword options of that head
    noise_seed: int = 0
    """Of the noise that actions are sampled from. It is drawn anew for every decision, but as a
    function of the frame's number in its episode alone, so that a policy is a function of what it
    sees."""
    dim: int = 128  # size of a frame's token, ``D``
    n_layers: int = 2  # temporal attention blocks
    n_heads: int = 4  # heads of each
    n_points: int = 12  # readouts whose values are the positions sighted, ``J``; 0 for none
    width: int = 256  # size of the context that the head reads, ``C``

    virtual_share: float = (
        0.8  # share of the batches that show virtual hands, see `virtual_episodes`
    )
    episodes_per_sample: int = 8
    """Episodes that a sample stands for with a frozen encoder, drawn from those that batches have
    named so far. LeRobot decodes an image for every sample, which then goes unused."""
    n_decisions: int = (
        5  # decisions in an episode at which the losses of forecast and action are computed
    )
    forecast_weight: float = 1.0
    """Weight of the loss of the forecast; 0 learns the recorded actions alone, without the target's
    path."""
    action_weight: float = 1.0  # weight of the loss of imitation
    closed_loop_weight: float = (
        4.0  # weight of the loss of palms that are rolled out, see `decisions`
    )
    ema_decay: float = 0.995  # of the average of the weights, which acts

    rig: Rig = field(default_factory=Rig)  # taken from the dataset
    rules: dict[str, Any] = field(default_factory=dict)
    """How the episodes of the dataset were played, as its manifest says, and how to evaluate."""
    rtc_config: RTCConfig | None = None  # real-time chunking, set by LeRobot's rollout

    # images in [0, 1], metres and radians: encoders and heads standardise by themselves
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(
            ("VISUAL", "STATE", "ENV", "ACTION"), NormalizationMode.IDENTITY
        )
    )

    optimizer_lr: float = 1.5e-3
    optimizer_weight_decay: float = 1e-4
    optimizer_grad_clip_norm: float = 1.0
    scheduler_warmup_steps: int = 100
    scheduler_decay_steps: int = 2_000

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (
            "obs_stride",
            "horizon",
            "episodes_per_sample",
            "n_decisions",
            "dim",
            "n_heads",
            "width",
        ):
            self._require(getattr(self, name) >= 1, name, "1 or more")
        weights = ("forecast_weight", "action_weight", "closed_loop_weight")
        for name in ("relative_dims", "n_points", "n_layers", "noise_seed", *weights):
            self._require(getattr(self, name) >= 0, name, "0 or more")
        n, most = self.n_obs_frames, MEMORY_FRAMES // self.obs_stride
        self._require(n is None or 0 <= n <= most, "n_obs_frames", f"0 to {most}, or null for all")
        self._require(
            1 <= self.n_action_steps <= self.horizon,
            "n_action_steps",
            f"1 to {self.horizon} (horizon)",
        )
        self._require(self.dim % self.n_heads == 0, "dim", "a multiple of n_heads")
        self._require(self.encoder in ENCODERS, "encoder", f"one of {', '.join(ENCODERS)}")
        self._require(self.head in HEADS, "head", f"one of {', '.join(HEADS)}")
        self._require(0 <= self.ema_decay < 1, "ema_decay", "0 or more and below 1")
        for name in ("n_steps", "n_draws"):
            if not 1 <= (value := self.head_options.get(name, 1)) <= MAX_SAMPLING:
                raise ValueError(
                    f"head_options.{name} is {value}, but must be 1 to {MAX_SAMPLING}."
                )
        if not 0 <= (value := self.head_options.get("closing_quantile", 0.5)) < 1:
            raise ValueError(
                f"head_options.closing_quantile is {value}, but must be 0 or more and below 1."
            )

    def _require(self, valid: bool, name: str, allowed: str) -> None:
        if not valid:
            raise ValueError(f"{name} is {getattr(self, name)!r}, but must be {allowed}.")

    @property
    def forecasts(self) -> bool:
        """Whether it learns to forecast the target; the head then reads the forecast instead of the
        state.
        """
        return self.freeze_encoder and self.forecast_weight > 0 and bool(self.rig.capture)

    @property
    def exact(self) -> bool:
        """Whether it acts in double precision: unless a part is a large network, or the device has
        none.
        """
        return self.encoder != "transformers" and self.head != "gr00t" and self.device != "mps"

    @property
    def grips(self) -> bool:
        """Whether the target must be gripped; the head then also reads how far each joint is
        closed.
        """
        return self.forecasts and self.rig.capture == CONTACT

    @property
    def sees_motion(self) -> bool:
        """Whether the encoder takes each image together with the one before."""
        return ENCODERS[self.encoder].sees_motion

    @property
    def lookback(self) -> list[int]:
        """Offsets of the frames that a window shows, oldest first [frames]."""
        n = WINDOW_FRAMES if self.n_obs_frames is None else self.n_obs_frames
        return [-i * self.obs_stride for i in range(n, -1, -1)]

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """Frames that LeRobot loads for every ``observation.*`` key; with a frozen encoder the
        current one alone.
        """
        if self.freeze_encoder:
            return None
        pairs = (0, 1) if self.sees_motion else (0,)
        return sorted({offset - pair for offset in self.lookback for pair in pairs})

    @property
    def action_delta_indices(self) -> list[int]:
        """Actions that LeRobot loads."""
        return list(range(self.horizon))

    @property
    def reward_delta_indices(self) -> None:
        """None: imitation learning uses no rewards."""

    @property
    def cameras(self) -> list[str]:
        """Keys of the images."""
        return list(self.image_features)

    @property
    def state_keys(self) -> list[str]:
        """Keys of the vector observations, in the order in which they are concatenated, the robot's
        state first.
        """
        vectors = (FeatureType.STATE, FeatureType.ENV)
        keys = [
            key for key, feature in (self.input_features or {}).items() if feature.type in vectors
        ]
        return sorted(keys, key=lambda key: key != "observation.state")

    def validate_features(self) -> None:
        """Check that the dataset has what the policy needs.

        Raises:
            ValueError: if there is no RGB image or no flat action, or no state that actions could
                be relative to.
        """
        if not self.image_features:
            raise ValueError(
                f"ObAct needs at least one image, but the inputs are "
                f"{sorted(self.input_features or {})}."
            )
        for key, feature in self.image_features.items():
            if len(feature.shape) != 3 or feature.shape[0] != 3:
                raise ValueError(
                    f"{key} has shape {feature.shape}, but must be RGB, (3, height, width)."
                )
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ValueError(
                f"'action' must be a flat vector, but the outputs are {self.output_features}."
            )
        state = self.robot_state_feature
        sizes = min(state.shape[0] if state else 0, self.action_feature.shape[0])
        self._require(
            self.relative_dims <= sizes,
            "relative_dims",
            f"0 to {sizes}, which state and action both have",
        )

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW as LeRobot builds it when no optimiser is given."""
        decay, clip = self.optimizer_weight_decay, self.optimizer_grad_clip_norm
        return AdamWConfig(lr=self.optimizer_lr, weight_decay=decay, grad_clip_norm=clip)

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a warm-up and cosine decay, which LeRobot shortens to the steps of the run."""
        return CosineDecayWithWarmupSchedulerConfig(
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
            peak_lr=self.optimizer_lr,
            decay_lr=0.02 * self.optimizer_lr,
        )
