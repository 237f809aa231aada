"""Configuration of ObAct, ``--policy.type=obact``."""

from collections.abc import Callable
from dataclasses import dataclass, field
from inspect import signature
from operator import attrgetter
from typing import Any, ClassVar

from draccus.utils import ParsingError
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim import AdamWConfig, CosineDecayWithWarmupSchedulerConfig
from lerobot.policies.rtc import RTCConfig
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE

from .encoders import ENCODERS, EYE_PX, SHIPPED
from .gr00t_head import Gr00tHead
from .heads import ActionHead

AT_LEAST = {
    "n_obs_steps": 1,
    "n_future_steps": 0,
    "drop_n_last_frames": 0,
    "horizon": 1,
    "inference_delay": 0,
    "dim": 1,
    "n_layers": 0,
    "n_heads": 1,
    "n_points": 1,
    "width": 1,
    "n_hands": 1,
    "n_decisions": 1,
    "forecast_weight": 0,
    "closed_loop_weight": 0,
    "embodiment.delay_frames": 0,
    "embodiment.palm_speed_m_s": 0,
}
"""Minimum value of each option."""
HEADS: dict[str, type[ActionHead] | type[Gr00tHead]] = {"diffusion": ActionHead, "gr00t": Gr00tHead}
CONTACT = "contact"
"""The rule of capture under which targets must be gripped; under all others the palm has to come
near enough."""
IMAGES = f"{OBS_IMAGES}."
SIGHTINGS = "observation.sightings."
"""Keys of the images of a view, and of what the frozen eye saw in them."""
SHIPPED_WEIGHTS = f"{{view}}_{EYE_PX}"  # of the eyes that ship, as an option of the encoder
MOST_RELATIVE = 3  # coordinates of a place
N_CALIBRATION = 9  # numbers of a camera's calibration, see `Embodiment`
FINAL_LR_SHARE = 0.02  # of the learning rate, to which the schedule decays


@dataclass(frozen=True)
class Embodiment:
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

    The defaults suit any dataset. For one of DynaHOI, the command in `README.md` sets
    ``n_obs_steps``, ``n_future_steps`` and ``n_hands`` as well, for the closed loop.
    """

    sees_frames_once: ClassVar[bool] = True
    """A frame that is shown again while actions are queued changes nothing."""

    n_obs_steps: int = 6  # frames that a sample of the training shows, up to the current one
    n_future_steps: int = 0
    """Frames after the current one that a sample shows as well. Through these a palm is rolled out,
    which needs sightings as a column (`dynahoi encode`) and the target's path."""
    drop_n_last_frames: int = 0
    """Last frames of a recording from which LeRobot makes no sample: those after the catch."""
    horizon: int = 8  # actions in a predicted chunk, ``H``
    n_action_steps: int = 1  # actions of a chunk that are executed before the policy replans
    inference_delay: int = 0
    """Actions of a chunk that will have expired when it is ready. Only `select_action` reads this,
    as for `lerobot-eval`; callers of `predict_action_chunk` pass their own."""
    relative_dims: int | None = None
    """Leading entries of an action that say where to go in the frame of the same entries of
    ``observation.state`` [m]; they are predicted as displacements. 0 for actions of another kind.
    By default three, or as many as both have; 0 if the dataset says that its actions are
    displacements."""

    encoder: str = ""
    """One of `ENCODERS`. By default the eye, with the weights that ship, where the dataset is of
    DynaHOI and there are such for all images, and else ``conv``, which is trained."""
    encoder_options: dict[str, Any] = field(default_factory=dict)
    """Keyword options of that encoder. In a text, ``{view}`` stands for the last part of the key of
    the image, so that each camera may start from weights of its own."""
    freeze_encoder: bool | None = None
    """Whether training leaves its weights alone; by default those that ``weights`` names."""
    head: str = "diffusion"  # one of `HEADS`
    head_options: dict[str, Any] = field(default_factory=dict)  # keyword options of that head
    dim: int = 128  # size of a frame's token, ``D``
    n_layers: int = 2  # temporal attention blocks
    n_heads: int = 4  # heads of each
    n_points: int = 12  # readouts whose values are the positions sighted, ``J``
    width: int = 256  # size of the context that the head reads

    n_hands: int = 2  # hands that are drawn for each window, see `windows`
    virtual_share: float = 0.8  # share of those that the policy leads; others are as recorded
    n_decisions: int = 6  # decisions of a hand at which the losses of forecast and action are taken
    delayed_share: float = 0.5
    """Share of the training steps in which inference takes 1 to ``horizon - 1`` frames: a policy
    then learns to act on the forecast of when its commands take effect."""
    forecast_weight: float = 1.0
    """Weight of the loss of the forecast; 0 learns the recorded actions alone, without the target's
    path."""
    closed_loop_weight: float = 4.0
    """Weight of the loss of palms that are rolled out, see `losses`; with 10 that loss became no
    smaller."""

    embodiment: Embodiment = field(default_factory=Embodiment)  # taken from the dataset
    rules: dict[str, Any] = field(default_factory=dict)
    """How the episodes of the dataset were played, as its manifest says, and how to evaluate."""
    rtc_config: RTCConfig | None = None  # real-time chunking, set by LeRobot's rollout

    # images in [0, 1], meters and radians: encoders and heads standardize by themselves
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(
            ("VISUAL", "STATE", "ENV", "ACTION"), NormalizationMode.IDENTITY
        )
    )

    optimizer_lr: float = 1.5e-3
    optimizer_weight_decay: float = 1e-4
    optimizer_grad_clip_norm: float = 1.0
    scheduler_warmup_steps: int = 100
    scheduler_decay_steps: int = 1_600

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in AT_LEAST.items():
            self._require(attrgetter(name)(self) >= least, name, f"{least} or more")
        self._require(self.embodiment.fps > 0, "embodiment.fps", "above 0")
        calibrated = all(len(one) == N_CALIBRATION for one in self.embodiment.calibration.values())
        allowed = f"{N_CALIBRATION} numbers for each camera"
        self._require(calibrated, "embodiment.calibration", allowed)
        self._require(
            1 <= self.n_action_steps <= self.horizon,
            "n_action_steps",
            f"1 to {self.horizon} (horizon)",
        )
        self._require(self.dim % self.n_heads == 0, "dim", "a multiple of n_heads")
        allowed = f"one of {', '.join(ENCODERS)}"
        self._require(not self.encoder or self.encoder in ENCODERS, "encoder", allowed)
        self._require(self.head in HEADS, "head", f"one of {', '.join(HEADS)}")
        for name, kind in (("head", HEADS[self.head]), ("encoder", ENCODERS.get(self.encoder))):
            given = getattr(self, f"{name}_options").keys()
            known = _options_of(kind) if kind else list(given)
            self._require(given <= {*known}, f"{name}_options", f"of {', '.join(known)}")
        for name in ("delayed_share", "virtual_share"):
            self._require(0 <= getattr(self, name) <= 1, name, "0 to 1")
        identity = all(
            mode == NormalizationMode.IDENTITY for mode in self.normalization_mapping.values()
        )
        allowed = "IDENTITY for everything: encoders and heads standardize by themselves"
        self._require(identity, "normalization_mapping", allowed)
        exact = "false: this policy acts in double precision, which autocast leaves alone"
        self._require(not (self.use_amp and self.exact), "use_amp", exact)

    def _require(self, valid: bool, name: str, allowed: str) -> None:
        """Refuse the value of an option, by draccus's own error: LeRobot's command line shows what
        that says, and hides what a ValueError in a config says.
        """
        if not valid:
            value = attrgetter(name)(self)
            raise ParsingError(f"{name} is {value!r}, but must be {allowed}.")

    @property
    def forecasts(self) -> bool:
        """Whether it learns to forecast the target; the head then reads the forecast instead of the
        state.
        """
        known = self.forecast_weight > 0 and bool(self.embodiment.capture)
        return bool(self.freeze_encoder) and known

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
        return self.forecasts and self.embodiment.capture == CONTACT

    @property
    def acts_with_shipped_eyes(self) -> bool:
        """Whether each camera's images are encoded by the eye that ships for its view."""
        named = (
            self.encoder_options_of(key).get("weights") == SHIPPED_WEIGHTS.format(view=view_of(key))
            for key in self.cameras
        )
        return self.encoder == "eye" and all(named)

    def encoder_options_of(self, key: str) -> dict[str, Any]:
        """Return the encoder's options for an image's key: its view replaces ``{view}``."""
        view = view_of(key)
        return {
            name: x.replace("{view}", view) if isinstance(x, str) else x
            for name, x in self.encoder_options.items()
        }

    @property
    def sees_motion(self) -> bool:
        """Whether the encoder takes each image together with the one before."""
        return ENCODERS[self.encoder].sees_motion

    @property
    def history_steps(self) -> int:
        """Frames that are kept in play: with a forecast, as many as the last decision in a sample
        of the training sees, which is taken after ``n_future_steps``; otherwise `n_obs_steps`.
        """
        return self.n_obs_steps + (self.n_future_steps if self.forecasts else 0)

    @property
    def observation_delta_indices(self) -> list[int]:
        """Frames that LeRobot loads for every ``observation.*`` key."""
        return list(range(1 - self.n_obs_steps, 1 + self.n_future_steps))

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
    def sighting_keys(self) -> list[str]:
        """Keys of the columns that hold what a frozen encoder saw in the images."""
        return [SIGHTINGS + view_of(key) for key in self.cameras]

    @property
    def state_keys(self) -> list[str]:
        """Keys of the vector observations, in the order in which they are concatenated, the robot's
        state first.
        """
        vectors = (FeatureType.STATE, FeatureType.ENV)
        keys = [
            key for key, feature in (self.input_features or {}).items() if feature.type in vectors
        ]
        return sorted(keys, key=lambda key: key != OBS_STATE)

    def validate_features(self) -> None:
        """Check that the dataset has what the policy needs, and decide what its features decide.

        Raises:
            ValueError: if there is no RGB image or no flat action.
            ParsingError: if there is no state that actions could be relative to.
        """
        self.input_features = dict(map(_as_image, (self.input_features or {}).items()))
        if not self.image_features:
            raise ValueError(
                f"ObAct needs at least one image, but the inputs are {sorted(self.input_features)}."
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
        shared = min(state.shape[0] if state else 0, self.action_feature.shape[0])
        most = min(MOST_RELATIVE, shared)
        if self.relative_dims is None:
            self.relative_dims = most
        allowed = f"0 to {most}: coordinates of a place, which state and action both have"
        self._require(0 <= self.relative_dims <= most, "relative_dims", allowed)
        eyes = {f"{view_of(key)}_{x.shape[-1]}" for key, x in self.image_features.items()}
        pretrained = eyes <= SHIPPED.keys()
        if not self.encoder:
            self.encoder = "eye" if pretrained else "conv"
        if self.encoder == "eye" and pretrained and not self.encoder_options:
            self.encoder_options = {"weights": SHIPPED_WEIGHTS}
        if self.freeze_encoder is None:
            self.freeze_encoder = bool(self.encoder_options.get("weights"))

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW as LeRobot builds it when no optimizer is given."""
        return AdamWConfig(
            lr=self.optimizer_lr,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a warm-up and cosine decay, which LeRobot shortens to the steps of the run."""
        return CosineDecayWithWarmupSchedulerConfig(
            num_warmup_steps=self.scheduler_warmup_steps,
            num_decay_steps=self.scheduler_decay_steps,
            peak_lr=self.optimizer_lr,
            decay_lr=FINAL_LR_SHARE * self.optimizer_lr,
        )


def view_of(key: str) -> str:
    """Return the view of an image's key: its last part."""
    return key.rsplit(".", maxsplit=1)[-1]


def _options_of(kind: Callable[..., Any]) -> list[str]:
    """Return the names of a constructor's arguments that have defaults."""
    parameters = signature(kind).parameters
    return [name for name, p in parameters.items() if p.default is not p.empty]


def _as_image(entry: tuple[str, PolicyFeature]) -> tuple[str, PolicyFeature]:
    """Return, for a column of sightings, the image in which the policy will see as much."""
    key, _ = entry
    if not key.startswith(SIGHTINGS):
        return entry
    return key.replace(SIGHTINGS, IMAGES), PolicyFeature(FeatureType.VISUAL, (3, EYE_PX, EYE_PX))
