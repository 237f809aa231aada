"""What an ObAct policy is made of, as a LeRobot policy config."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig, CosineDecayWithWarmupSchedulerConfig
from lerobot.policies.rtc import RTCConfig

from .windows import DecisionWindows

ACTION_FRAMES = ("auto", "absolute", "relative")


@PreTrainedConfig.register_subclass("obact")
@dataclass
class ObActConfig(PreTrainedConfig):
    """Observe before act: a short observed history, spatiotemporal attention and a generative action head.

    Attributes:
        n_obs_frames: Observed frames before the current one, the paper's ``s``; 0 is the single-frame
            control.
        obs_stride: Distance between observed frames [frames].
        fps: Frame rate of the data [Hz]; taken from the dataset when training starts.
        image_size: Side to which every image is resized [px]; 0 keeps the size of the dataset.
        horizon: Actions in a predicted chunk.
        n_action_steps: Actions of a chunk that are executed before the policy plans again.
        latency_frames: Frames between an observation and the execution of the action that answers it. A chunk begins
            at its observation, so that many of its actions are past when it is ready, and are skipped.
        replan_key: Observation whose rise (0 -> 1) drops the rest of the chunk; "" never does. Chunks planned
            before the rise are never executed, so none are learned from.
        action_frame: "absolute", "relative" (the first `relative_dims` actions are predicted as displacements
            from the same entries of the current ``observation.state``) or "auto" (relative where the
            dataset's statistics show that action and state are the same quantity).
        relative_dims: Leading action dimensions that "relative" concerns.
        relative_weight: Weight of those dimensions in the loss. Three of them are easily drowned by fifteen
            fingers that move as one.
        n_decisions: Moments per training sample at which the loss is taken, see `windows.py`.
        decision_stride: Distance between those moments [frames].
        backbone: Name of the image encoder, one file each in ``backbones/``.
        backbone_options: Keyword options of that encoder.
        head: Name of the action head, one file each in ``heads/``.
        head_options: Keyword options of that head.
        width: Size of every token.
        n_attention_layers: Spatiotemporal attention blocks.
        n_attention_heads: Heads of every attention.
        dropout: Dropout probability in attention blocks and head.
        ema_decay: Decay of the averaged weights used for acting; 0 turns the average off.
        privileged_key: Column of the dataset with a position in the coordinates of ``observation.state`` that the
            encoder learns to see in every frame, here "target.pose"; "" learns from actions alone.
        privileged_weight: Weight of that loss.
        random_shift_px: Augmentation, largest image shift, the same for all frames of a sample [px].
        color_jitter: Augmentation, largest relative change of brightness and contrast.
        noise_seed: Seed of the noise that a chunk starts from while acting, None draws from the global
            generator.
        noise_scale: Spread of that noise: 1 samples a chunk, 0 starts from the noise's mean, which comes close to
            the mean of all good chunks and keeps its mind from one plan to the next.
        compile_model: Compile backbone, attention and head with ``torch.compile``.
        compile_backend: Backend of ``torch.compile``.
        rtc_config: Real-time chunking, set by LeRobot's rollout.
    """

    n_obs_frames: int = 5
    obs_stride: int = 2
    fps: float = 20.0
    image_size: int = 96

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
        return DecisionWindows(self.n_obs_frames, self.obs_stride, self.horizon, self.n_decisions, self.decision_stride)

    @property
    def observation_delta_indices(self) -> list[int]:
        """Frames LeRobot loads for every ``observation.*`` key, relative to the sample [frames]."""
        return self.windows.observation_offsets

    @property
    def action_delta_indices(self) -> list[int]:
        """Actions LeRobot loads, relative to the sample [frames]."""
        return self.windows.action_offsets

    @property
    def reward_delta_indices(self) -> None:
        """Imitation needs no reward."""
        return

    @property
    def proprioceptive_keys(self) -> list[str]:
        """Names of the vector observations, in the order in which they are concatenated."""
        vectors = (FeatureType.STATE, FeatureType.ENV)
        return [key for key, feature in (self.input_features or {}).items() if feature.type in vectors]

    def validate_features(self) -> None:
        """Check that the dataset offers what the policy needs.

        Raises:
            ValueError: If there is no RGB image, no flat action, or no state that actions could be relative
            to.
        """
        if not self.image_features:
            raise ValueError(f"ObAct needs at least one image, but the inputs are {sorted(self.input_features or {})}.")
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
        return bool(state and action) and self.relative_dims <= min(state.shape[0], action.shape[0])

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
