"""Control classes: how fast a hand may move and how late its commands take effect, the same for whoever moves it."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

from dynahoi_lerobot.foundation.conventions import CONTROL_DT


@dataclass(frozen=True)
class ControlClass:
    """The limits that the world enforces on every command, of experts, baselines and policies alike.

    Attributes:
        name: its name in recipes and results.
        palm_speed_m_s: greatest norm of the palm's velocity [m/s]. Capture rule ``contact`` keeps its gantry's limit.
        joint_speed_rad_s: greatest speed of each finger joint [rad/s].
        latency_ms: time between a command and its effect [ms].
    """

    name: str
    palm_speed_m_s: float
    joint_speed_rad_s: float
    latency_ms: float

    @property
    def latency_frames(self) -> int:
        """The latency in control steps, rounded up."""
        return ceil(self.latency_ms / 1000 / CONTROL_DT - 1e-9)


CONTROL_CLASSES = {
    control.name: control
    for control in (
        ControlClass("unlimited", palm_speed_m_s=2.0, joint_speed_rad_s=20.0, latency_ms=0.0),
        ControlClass("standard", palm_speed_m_s=0.5, joint_speed_rad_s=20.0, latency_ms=0.0),
        ControlClass("late", palm_speed_m_s=0.5, joint_speed_rad_s=20.0, latency_ms=150.0),
    )
}
"""``unlimited`` is the paper's world, as far as it can be told; ``late`` has the latency of a camera, a network and an
arm. At 2 m/s a memoryless pursuit of the true position catches everything; at 0.5 m/s it does not."""

DEFAULT_CONTROL_CLASS = "standard"


def control_class_of(name: str) -> ControlClass:
    """Return the control class called ``name``.

    Raises:
        ValueError: naming the class received and the ones there are.
    """
    if name not in CONTROL_CLASSES:
        raise ValueError(f"unknown control class {name!r}; known: {', '.join(CONTROL_CLASSES)}")
    return CONTROL_CLASSES[name]
