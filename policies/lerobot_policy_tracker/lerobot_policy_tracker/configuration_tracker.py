"""Configuration of the tracker, ``--policy.type=tracker``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig, CosineDecayWithWarmupSchedulerConfig
from lerobot.policies.rtc import RTCConfig

from .windows import DecisionWindows

ACTION_FRAMES = ("auto", "absolute", "relative")
MEMORIES = ("recent", "window", "both", "episode")
MEMORY_MODULES = ("attention", "gru")


@PreTrainedConfig.register_subclass("tracker")
@dataclass
class TrackerConfig(PreTrainedConfig):
    """The engineered tracker: an eye, motion models fitted to what it saw, and an action head.

    The published checkpoints use ``backbone="eye"`` or "two_eyes" and ``head="intercept"``. The defaults are a small
    convolutional encoder and a flow-matching head, for comparison.

    Attributes:
        n_obs_frames: observed frames before the current one, the paper's ``s``; 0 is the single-frame
            control.
        obs_stride: distance between observed frames [frames].
        memory: which frames a decision sees: "recent" those, "window" frames of the observation window, which stay
            for the whole episode, "both", or "episode", where older frames are seen whether the hand moved or not.
        n_window_frames: offsets at which those older frames are looked for, spaced geometrically.
        window_reach: the largest of those offsets [frames].
        memory_module: what fuses the frames: spatiotemporal "attention", or a "gru" over all frames in turn.
        fps: frame rate of the data [Hz]; taken from the dataset when training starts.
        image_size: side to which every image is resized [px]; 0 keeps the size of the dataset.
        motion: show the backbone each image together with the one before, for backbones that see what moves.
        horizon: actions in a predicted chunk, ``H``.
        n_action_steps: actions of a chunk that are executed before the policy replans.
        latency_frames: delay between an observation and the execution of the action predicted from it [frames]. That
            many leading actions of a chunk lie in the past when it is ready, and are skipped.
        replan_key: observation whose last entry rises (0 -> 1) when the hand may move, which triggers replanning and
            drops the rest of the chunk; "" disables this. Chunks predicted before the rise are never executed, so
            they are masked in the loss.
        action_frame: "absolute", "relative" (the first `relative_dims` actions are predicted as displacements
            from the same entries of the current ``observation.state``) or "auto" (relative where the
            dataset's statistics show that action and state are the same quantity).
        relative_dims: leading action dimensions that "relative" concerns.
        relative_weight: weight of those dimensions in the loss over that of the others; at 1 the three palm
            dimensions are few beside fifteen correlated finger joints.
        n_decisions: decisions per training sample at which the loss is computed, see `windows.py`.
        decision_stride: distance between those decisions [frames].
        backbone: name of the image encoder, one file each in ``backbones/``.
        backbone_options: keyword options of that encoder.
        head: name of the action head, one file each in ``heads/``.
        head_options: keyword options of that head.
        width: size of every token, ``D``.
        n_attention_layers: spatiotemporal attention blocks.
        n_attention_heads: heads of every attention.
        dropout: dropout probability in attention blocks and head.
        ema_decay: decay of the exponential moving average of the weights, which is used for acting; 0 disables it.
        privileged_key: column of the dataset with a position in the coordinates of ``observation.state``, such as
            "target.pose", which an auxiliary loss on the visual encoder predicts in every frame; "" disables it.
        privileged_weight: weight of that loss.
        random_shift_px: augmentation, largest image shift, the same for all frames of a sample [px].
        color_jitter: augmentation, largest relative change of brightness and contrast.
        noise_seed: seed of the noise that a chunk is sampled from while acting; None draws from the global generator.
        noise_scale: standard deviation of that noise: 1 samples a chunk; 0 starts from the mean of the noise, which
            gives about the mean chunk and makes consecutive chunks consistent.
        compile_model: compile backbone, attention and head with ``torch.compile``.
        compile_backend: backend of ``torch.compile``.
        rtc_config: real-time chunking, set by LeRobot's rollout.
    """

    n_obs_frames: int = 5
    obs_stride: int = 2
    memory: str = "recent"
    n_window_frames: int = 10
    window_reach: int = 128
    memory_module: str = "attention"
    fps: float = 20.0
    image_size: int = 96
    motion: bool = False

    horizon: int = 16
    n_action_steps: int = 8
    latency_frames: int = 0
    replan_key: str = "observation.phase"
    action_frame: str = "auto"
    relative_dims: int = 3
    relative_weight: float = 1.0

    n_decisions: int = 1
    decision_stride: int = 4

    backbone: str = "conv"
    backbone_options: dict[str, Any] = field(default_factory=dict)
    head: str = "flow"
    head_options: dict[str, Any] = field(default_factory=dict)
    width: int = 128
    n_attention_layers: int = 2
    n_attention_heads: int = 4
    dropout: float = 0.0
    ema_decay: float = 0.999

    privileged_key: str = ""
    privileged_weight: float = 1.0
    random_shift_px: int = 0
    color_jitter: float = 0.0
    noise_seed: int | None = 0
    noise_scale: float = 1.0
    compile_model: bool = False
    compile_backend: str = "inductor"
    rtc_config: RTCConfig | None = None

    # Images stay in [0, 1]: every backbone standardises with the constants it was trained with.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "VISUAL": NormalizationMode.IDENTITY,
            "STATE": NormalizationMode.MEAN_STD,
            "ENV": NormalizationMode.MEAN_STD,
            "ACTION": NormalizationMode.MEAN_STD,
        }
    )

    optimizer_lr: float = 5e-4
    optimizer_weight_decay: float = 1e-4
    optimizer_betas: tuple[float, float] = (0.9, 0.95)
    optimizer_grad_clip_norm: float = 1.0
    scheduler_warmup_steps: int = 5_000
    scheduler_decay_steps: int = 100_000
    scheduler_decay_lr: float = 2e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require(self.n_obs_frames >= 0, "n_obs_frames", "0 (single-frame control) or more")
        self._require(self.fps > 0, "fps", "above 0 Hz")
        self._require(1 <= self.n_action_steps <= self.horizon, "n_action_steps", f"1 to {self.horizon} (horizon)")
        most = self.horizon - self.n_action_steps
        self._require(0 <= self.latency_frames <= most, "latency_frames", f"0 to {most} (horizon - n_action_steps)")
        self._require(self.memory in MEMORIES, "memory", f"one of {', '.join(MEMORIES)}")
        self._require(self.memory_module in MEMORY_MODULES, "memory_module", f"one of {', '.join(MEMORY_MODULES)}")
        self._require(self.action_frame in ACTION_FRAMES, "action_frame", f"one of {', '.join(ACTION_FRAMES)}")
        self._require(self.relative_weight > 0, "relative_weight", "above 0")
        self._require(self.privileged_weight >= 0, "privileged_weight", "0 or more")
        self._require(self.noise_scale >= 0, "noise_scale", "0 or more")
        self._require(0 <= self.ema_decay < 1, "ema_decay", "0 (off) or more and below 1")
        self._require(self.width % (2 * self.n_attention_heads) == 0, "width", "a multiple of 2 x n_attention_heads")
        for name in ("obs_stride", "horizon", "n_decisions", "decision_stride", "relative_dims"):
            self._require(getattr(self, name) >= 1, name, "1 or more")

    def _require(self, valid: bool, name: str, allowed: str) -> None:
        if not valid:
            raise ValueError(f"{name} is {getattr(self, name)!r}, but must be {allowed}.")

    @property
    def windows(self) -> DecisionWindows:
        """The frame offsets of a training sample."""
        n_recent = 0 if self.memory == "window" else self.n_obs_frames
        offsets = () if self.memory == "recent" else self._older_offsets(n_recent * self.obs_stride + 1)
        forgets = self.memory != "episode"
        return DecisionWindows(
            n_recent, self.obs_stride, self.horizon, self.n_decisions, self.decision_stride, offsets, forgets
        )

    def _older_offsets(self, nearest: int) -> tuple[int, ...]:
        """Spread `n_window_frames` offsets geometrically from the nearest to `window_reach`, without repeats."""
        ratio = (self.window_reach / nearest) ** (1 / max(self.n_window_frames - 1, 1))
        return tuple(sorted({round(nearest * ratio**i) for i in range(self.n_window_frames)}))

    @property
    def observation_delta_indices(self) -> list[int]:
        """Frames LeRobot loads for every ``observation.*`` key, relative to the sample [frames]."""
        offsets = self.windows.observation_offsets
        return sorted({*offsets, *(offset - 1 for offset in offsets)}) if self.motion else offsets

    @property
    def action_delta_indices(self) -> list[int]:
        """Actions LeRobot loads, relative to the sample [frames]."""
        return self.windows.action_offsets

    @property
    def reward_delta_indices(self) -> None:
        """None: imitation learning uses no rewards."""
        return

    @property
    def proprioceptive_keys(self) -> list[str]:
        """Names of the vector observations, in the order in which they are concatenated."""
        vectors = (FeatureType.STATE, FeatureType.ENV)
        return [key for key, feature in (self.input_features or {}).items() if feature.type in vectors]

    @property
    def state_dim(self) -> int:
        """Size of all vector observations together, ``S``."""
        inputs = self.input_features or {}
        return sum(inputs[key].shape[0] for key in self.proprioceptive_keys)

    @property
    def action_dim(self) -> int:
        """Size of an action, ``A``; 0 without an action."""
        return self.action_feature.shape[0] if self.action_feature else 0

    def validate_features(self) -> None:
        """Check that the dataset has the features the policy needs.

        Raises:
            ValueError: if there is no RGB image, no flat action, or no state that actions could be relative to.
        """
        if not self.image_features:
            raise ValueError(
                f"The tracker needs at least one image, but the inputs are {sorted(self.input_features or {})}."
            )
        for key, feature in self.image_features.items():
            if len(feature.shape) != 3 or feature.shape[0] != 3:
                raise ValueError(f"{key} has shape {feature.shape}, but must be RGB, (3, height, width).")
        if self.action_feature is None or len(self.action_feature.shape) != 1:
            raise ValueError(f"'action' must be a flat vector, but the outputs are {self.output_features}.")
        if self.action_frame == "relative" and not self.can_be_relative:
            raise ValueError(
                f"action_frame is 'relative' for {self.relative_dims} dimensions, but 'observation.state' and "
                "'action' do not both have that many; use action_frame='absolute' or a smaller relative_dims."
            )

    @property
    def can_be_relative(self) -> bool:
        """Whether state and action are both long enough for `relative_dims`."""
        state, action = self.robot_state_feature, self.action_feature
        if state is None or action is None:
            return False
        return self.relative_dims <= min(state.shape[0], action.shape[0])

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW as LeRobot builds it when no optimiser is given."""
        return AdamWConfig(
            lr=self.optimizer_lr,
            betas=self.optimizer_betas,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a warm-up and cosine decay, which LeRobot shortens to the steps of the run."""
        return CosineDecayWithWarmupSchedulerConfig(
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
            peak_lr=self.optimizer_lr,
            decay_lr=self.scheduler_decay_lr,
        )
