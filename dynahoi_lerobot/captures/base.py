"""What a capture rule is: an event within a control step, what it does to the target, and a verdict at the end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dynahoi_lerobot.control_class import ControlClass
from dynahoi_lerobot.foundation.conventions import LOCALIZATION_RADIUS_M
from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.motions import Motion
from dynahoi_lerobot.scene.contact_sensors import TargetContacts

CAPTURES: Registry[type[CaptureRule]] = Registry("capture rule", "dynahoi_lerobot.captures")

NO_EVENT = -1


@dataclass(frozen=True)
class Weld:
    """The target is fixed to the palm as it lies, at the palm's velocity, and passes through everything else."""


@dataclass(frozen=True)
class Release:
    """The target is neither driven nor tethered any more, and keeps its velocity.

    Attributes:
        collides_with: collision bits that it asks for from now on.
    """

    collides_with: int


@dataclass(frozen=True, eq=False)
class Substeps:
    """What n worlds did in the 25 physics steps of one control step.

    Attributes:
        acting: (n,) bool, the control phase has begun.
        palm_distance: (n, 25) palm centre to target centre [m].
        contacts: of shape (n, 25), what touches the target; None if the rule uses no contact sensors.
    """

    acting: np.ndarray
    palm_distance: np.ndarray
    contacts: TargetContacts | None


@dataclass(frozen=True, eq=False)
class Track:
    """What a verdict is read from: one episode's T frames in the control phase.

    Attributes:
        joints: (T, 15) joint angles [rad].
        open_joints: (15,) joint angles of the open hand [rad].
        reference_joints: (15,) joint angles of the reference grasp [rad].
        localized: (T,) bool.
        contacts: of shape (T,), what touched the target; zero if the rule uses no contact sensors.
        palm_distance: (T,) palm centre to target centre [m].
        palm_pos_h: (T, 3) palm centre [m], world.
    """

    joints: np.ndarray
    open_joints: np.ndarray
    reference_joints: np.ndarray
    localized: np.ndarray
    contacts: TargetContacts
    palm_distance: np.ndarray
    palm_pos_h: np.ndarray

    def first(self, frames: int) -> Track:
        """Return the first ``frames`` of the T frames."""
        part = slice(frames)
        return replace(
            self,
            joints=self.joints[part],
            localized=self.localized[part],
            contacts=self.contacts[part],
            palm_distance=self.palm_distance[part],
            palm_pos_h=self.palm_pos_h[part],
        )


class CaptureRule(ABC):
    """A rule; it has no state of its own and changes nothing itself, so one instance serves all worlds."""

    name: str
    effect: ClassVar[Weld | Release]
    """What its event does to the target, once per episode."""
    expert: ClassVar[str]
    """Who demonstrates under this rule, unless a recipe says otherwise."""
    hand: ClassVar[str]
    """The hand that plays under it, likewise."""
    localization_radius_m: ClassVar[float] = LOCALIZATION_RADIUS_M
    """Palm centre to target centre, below which the target is localised [m]; all metrics follow it."""
    gantry_speed_m_s: ClassVar[float | None] = None
    """Speed limit of each axis of the palm's gantry [m/s], where the rule replaces that of the control class."""
    uses_contact_sensors: ClassVar[bool] = False
    """Whether events and verdicts are read from what touches the target."""
    hold_frames: ClassVar[int] = 0
    """Frames that every episode has left after the intercept, at least."""
    settle_frames: ClassVar[int] = 10
    """Frames after the first localisation in which the verdict falls; then an evaluated episode may end."""

    @classmethod
    def palm_speed_m_s(cls, control: ControlClass) -> float:
        """Return the palm's greatest speed [m/s]: the control class's, or that of the rule's gantry."""
        return control.palm_speed_m_s if cls.gantry_speed_m_s is None else cls.gantry_speed_m_s

    @abstractmethod
    def collisions(self, motion: Motion) -> int:
        """Return the collision bits that a target asks for from the start."""

    @abstractmethod
    def events(self, substeps: Substeps) -> np.ndarray:
        """Return (n,) the physics step within the control step after which ``effect`` is due, or ``NO_EVENT``.

        Also called for worlds whose event has happened; the result is ignored there.
        """

    @abstractmethod
    def captured(self, track: Track) -> np.ndarray:
        """Return (T,) bool: the rule regards the target as captured at each frame."""

    @abstractmethod
    def stage(self, track: Track) -> str:
        """Return how far the episode got."""

    @abstractmethod
    def success(self, track: Track) -> bool:
        """Return the verdict; once it is a success, no further frame changes it."""

    def succeeded(self, track: Track) -> np.ndarray:
        """Return (T,) bool: the frames up to and including this one make the episode a success."""
        frames = range(1, len(track.localized) + 1)
        if not self.success(track):
            return np.zeros(len(frames), bool)
        decisive = bisect_left(frames, True, key=lambda count: self.success(track.first(count)))
        return np.arange(len(frames)) >= decisive
