"""Rules of an episode: control classes, protocols, and the phase of a frame.

Control classes say how fast a hand may move and how late its commands take effect, the same for
whoever moves it; protocols say what the hand may see, and when.
"""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from dynahoi_lerobot.core.conventions import frames_until


@dataclass(frozen=True)
class ControlClass:
    """The limits that the world enforces on every command, of experts, baselines and policies
    alike.

    Attributes:
        name: its name in recipes and results.
        palm_speed_m_s: greatest norm of the palm's velocity [m/s]. Capture rule ``contact`` keeps
            its gantry's limit.
        joint_speed_rad_s: greatest speed of each finger joint [rad/s].
        latency_ms: time between a command and its effect [ms].
    """

    name: str
    palm_speed_m_s: float
    joint_speed_rad_s: float
    latency_ms: float

    def __post_init__(self) -> None:
        """Refuse limits that no hand could keep."""
        for name in ("palm_speed_m_s", "joint_speed_rad_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if not self.latency_ms >= 0:
            raise ValueError(f"latency_ms must be 0 or more, got {self.latency_ms}")

    @property
    def latency_frames(self) -> int:
        """The latency in control steps, rounded up."""
        return frames_until(self.latency_ms / 1000)


CONTROL_CLASSES = MappingProxyType(
    {
        control.name: control
        for control in (
            ControlClass("unlimited", palm_speed_m_s=2.0, joint_speed_rad_s=20.0, latency_ms=0.0),
            ControlClass("standard", palm_speed_m_s=0.5, joint_speed_rad_s=20.0, latency_ms=0.0),
            ControlClass("late", palm_speed_m_s=0.5, joint_speed_rad_s=20.0, latency_ms=150.0),
        )
    }
)
"""``unlimited`` is the paper's world, as far as it can be told; ``late`` has the latency of a
camera, a network and an arm. At 2 m/s a memoryless pursuit of the true position catches everything;
at 0.5 m/s it does not."""

DEFAULT_CONTROL_CLASS = "standard"


@dataclass(frozen=True)
class Protocol:
    """What comes before the control phase, and what is seen in it.

    Attributes:
        name: its name in recipes and results.
        meaning: a line for the command line's help.
        has_window: the hand is held still for an observation window first (Section 3 of the paper).
        blind_control: all images are black from the first control frame on; proprioception stays.
        has_screen: a panel hides the target from the hand's camera for 0.3 to 0.6 s before it can
            be met.
    """

    name: str
    meaning: str
    has_window: bool = True
    blind_control: bool = False
    has_screen: bool = False


PROTOCOLS = MappingProxyType(
    {
        protocol.name: protocol
        for protocol in (
            Protocol("observe_before_act", "an observation window, then control"),
            Protocol("direct_act", "control from the first frame on", has_window=False),
            Protocol(
                "observe_then_blind",
                "an observation window, then control with black images",
                blind_control=True,
            ),
            Protocol(
                "occluded",
                "an observation window, then control; a screen hides the target in between",
                has_screen=True,
            ),
        )
    }
)
"""Under ``observe_then_blind`` only a prediction from the window tells where to go, and under
``occluded`` one from before the target vanishes."""

DEFAULT_PROTOCOL = "observe_before_act"


PHASES = ("observing", "acting")
"""The phase of a frame as policies see it, one-hot.

Two numbers where one would do: LeRobot stores a feature of one number as a scalar, and its
streaming reader makes no windows over scalars, which a policy with history asks for."""
ACTING = PHASES.index("acting")


def one_hot_phase(acting: np.ndarray) -> np.ndarray:
    """Return the phase of frames, (..., 2) float32: [1, 0] while observing, [0, 1] while ``acting``
    (...) bool.
    """
    return np.stack([~acting, acting], axis=-1).astype(np.float32)


def is_acting(phase: np.ndarray) -> np.ndarray:
    """Return (...) bool of a phase (..., 2), whether a command given at the frame takes effect."""
    return phase[..., ACTING] > 0.5
