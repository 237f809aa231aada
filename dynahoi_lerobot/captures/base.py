"""What a capture rule is: an event within a control step, what it changes in the world, and a verdict at the end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.motions import Motion

if TYPE_CHECKING:
    from dynahoi_lerobot.world.batch import WorldBatch

CAPTURES: Registry[type[CaptureRule]] = Registry("capture rule", "dynahoi_lerobot.captures")

NO_EVENT = -1


@dataclass(frozen=True, eq=False)
class Substeps:
    """What n worlds did in the 25 physics steps of one control step.

    Attributes:
        acting: (n,) bool, whether the hand may move.
        palm_distance: (n, 25) palm centre to target centre [m].
        touch: (n, 25, 7) what touches the target, as ``touch.read_touch`` tells; None if the rule asks for none.
    """

    acting: np.ndarray
    palm_distance: np.ndarray
    touch: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Track:
    """What a verdict is read from: one episode's frames in the control phase, (T, ...) each.

    Attributes:
        joints: (T, 15) [rad]; ``open_joints`` and ``reference_joints`` (15,) [rad].
        localized: (T,) bool.
        touch: (T, 7) what touches the target, as ``touch.read_touch`` tells; zero if the rule asks for none.
        palm_distance: (T,) [m].
        palm_pos_w: (T, 3) palm centre [m], world.
    """

    joints: np.ndarray
    open_joints: np.ndarray
    reference_joints: np.ndarray
    localized: np.ndarray
    touch: np.ndarray
    palm_distance: np.ndarray
    palm_pos_w: np.ndarray


class CaptureRule(ABC):
    """A rule; it has no state of its own, worlds keep theirs."""

    name: str
    expert: ClassVar[str]
    """Who demonstrates under this rule, unless a recipe says otherwise."""
    hand: ClassVar[str]
    """The embodiment that plays under it, likewise."""
    uses_contact_sensors: ClassVar[bool] = False
    """Whether it needs to know what touches the target."""
    hold_frames: ClassVar[int] = 0
    """Frames that every episode has left after the intercept, at least."""
    settle_frames: ClassVar[int] = 10
    """Frames after the first localisation in which the verdict falls; then an evaluated episode may end."""

    @abstractmethod
    def collisions(self, motion: Motion) -> int:
        """Return the collision bits that a target asks for from the start."""

    @abstractmethod
    def events(self, substeps: Substeps) -> np.ndarray:
        """Return (n,) the physics step within the control step after which ``apply`` is due, or ``NO_EVENT``.

        Worlds whose event has been are asked again, in vain.
        """

    @abstractmethod
    def apply(self, world: WorldBatch, i: int) -> None:
        """Change world ``i`` as the event demands; at most once per episode."""

    @abstractmethod
    def captured(self, track: Track) -> np.ndarray:
        """Return (T,) bool: the rule regards the target as captured at each frame."""

    @abstractmethod
    def stage(self, track: Track) -> str:
        """Return how far the episode got."""

    @abstractmethod
    def success(self, track: Track) -> bool:
        """Return the verdict."""
