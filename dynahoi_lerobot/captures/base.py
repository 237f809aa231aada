"""What a capture rule is: an event within a control step, what it changes in the world, and a verdict at the end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.motions import Motion
from dynahoi_lerobot.registry import Registry

if TYPE_CHECKING:
    from dynahoi_lerobot.world_batch import WorldBatch

CAPTURES: Registry[type[CaptureRule]] = Registry("capture rule", "dynahoi_lerobot.captures")

NO_EVENT = -1


@dataclass(frozen=True, eq=False)
class Substeps:
    """What n worlds did in the 25 physics steps of one control step.

    Attributes:
        ids: (n,) worlds.
        palm_distance: (n, 25) palm centre to target centre [m].
        contacts: (n, 25, 5) force of each finger on the target [N].
    """

    ids: np.ndarray
    palm_distance: np.ndarray
    contacts: np.ndarray


@dataclass(frozen=True, eq=False)
class Track:
    """What a verdict is read from: one episode's frames in the control phase, (T, ...) each.

    Attributes:
        joints: (T, 15) [rad]; ``open_joints`` and ``reference_joints`` (15,) [rad].
        localized: (T,) bool.
        contacts: (T, 5) bool, fingers that touch the target.
        palm_distance: (T,) [m].
    """

    joints: np.ndarray
    open_joints: np.ndarray
    reference_joints: np.ndarray
    localized: np.ndarray
    contacts: np.ndarray
    palm_distance: np.ndarray


class CaptureRule(ABC):
    """A rule; it has no state of its own, worlds keep theirs."""

    name: str
    settle_frames: int = 10
    """Frames after the first localisation in which the verdict falls; then an evaluated episode may end."""

    @abstractmethod
    def collisions(self, motion: Motion) -> int:
        """Return the collision bits that a target asks for from the start."""

    @abstractmethod
    def events(self, substeps: Substeps) -> np.ndarray:
        """Return (n,) the physics step within the control step after which ``apply`` is due, or ``NO_EVENT``."""

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
