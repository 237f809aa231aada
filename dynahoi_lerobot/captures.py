"""Capture rules: an event within a control step, what it does to the target, and what counts as a
catch.

``attach`` is the paper's rule: a target within the localization radius is welded to the hand; the
grasp is a matter of pose. ``attach_lenient`` is the track on which the paper evaluates
vision-language models, with a threshold of 1.0 u. ``contact`` is ours, the physical rule: nothing
is ever attached; a catch is what friction and the fingers hold while the hand moves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dynahoi_lerobot.core.conventions import (
    CONTROL_HZ,
    FINGERS,
    GANTRY_SPEED_M_S,
    LENIENT_RADIUS_M,
    LOCALIZATION_RADIUS_M,
)
from dynahoi_lerobot.core.episode import in_reference_grasp
from dynahoi_lerobot.core.numerics import runs
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.motions import Motion, PhysicalMotion
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.scene.model import ENVIRONMENT, HAND_BIT

NO_EVENT = -1
HELD_FRAMES = CONTROL_HZ // 2
"""A grip counts once it has lasted half a second."""
HELD_RADIUS_M = 0.05
"""The target's center stays this close to the palm center."""
HELD_TRAVEL_M = 0.05
"""The palm moves this far meanwhile, or whatever rests on a still hand would be held."""
SLIPPED_FRAMES = 3
"""A grip that lasted this long, and not long enough, was lost."""
THUMB = FINGERS.index("thumb")


@dataclass(frozen=True, eq=False)
class Track:
    """What a verdict is read from: one episode's T frames in the control phase.

    Attributes:
        joints: (T, 15) joint angles [rad].
        open_joints: (15,) joint angles of the open hand [rad].
        reference_joints: (15,) joint angles of the reference grasp [rad].
        localized: (T,) bool.
        contacts: of shape (T,), what touched the target; zero if the rule uses no contact sensors.
        palm_distance_m: (T,) palm center to target center [m].
        palm_pos_h: (T, 3) palm center [m], home frame.
    """

    joints: np.ndarray
    open_joints: np.ndarray
    reference_joints: np.ndarray
    localized: np.ndarray
    contacts: TargetContacts
    palm_distance_m: np.ndarray
    palm_pos_h: np.ndarray

    def first(self, frames: int) -> Track:
        """Return the first ``frames`` of the T frames."""
        by_frame = ("joints", "localized", "contacts", "palm_distance_m", "palm_pos_h")
        return replace(self, **{name: getattr(self, name)[:frames] for name in by_frame})


class CaptureRule(ABC):
    """A rule; it has no state of its own and changes nothing itself, so one instance serves all
    worlds.

    Its event happens once per episode: from then on the target is neither driven nor tethered.
    """

    name: str
    welds: ClassVar[bool]
    """Whether the event fixes the target to the palm as it lies, at the palm's velocity; else it
    keeps its own."""
    collides_after: ClassVar[int]
    """Collision bits that the target asks for from its event on."""
    expert: ClassVar[str]
    """Who demonstrates under this rule, unless a recipe says otherwise."""
    hand: ClassVar[str]
    """The hand that plays under it, likewise."""
    localization_radius_m: ClassVar[float] = LOCALIZATION_RADIUS_M
    """Palm center to target center, below which the target is localized [m]; all metrics follow
    it."""
    gantry_speed_m_s: ClassVar[float | None] = None
    """Speed limit of each axis of the palm's gantry [m/s], if the rule replaces the control class's
    limit."""
    uses_contact_sensors: ClassVar[bool] = False
    """Whether events and verdicts are read from what touches the target."""
    hold_frames: ClassVar[int] = 0
    """Frames that every episode has left after the intercept, at least."""
    settle_frames: ClassVar[int] = 10
    """Frames after the first localization in which the verdict falls; then an evaluated episode may
    end."""

    @classmethod
    def palm_speed_m_s(cls, control: ControlClass) -> float:
        """Return the palm's greatest speed [m/s]: the control class's limit, or the limit of the
        rule's gantry.
        """
        return control.palm_speed_m_s if cls.gantry_speed_m_s is None else cls.gantry_speed_m_s

    @abstractmethod
    def collisions(self, motion: Motion) -> int:
        """Return the collision bits that a target asks for from the start."""

    @abstractmethod
    def events(
        self, acting: np.ndarray, palm_distance_m: np.ndarray, contacts: TargetContacts | None
    ) -> np.ndarray:
        """Return (n,) the physics step within the control step after which its event is due, or
        ``NO_EVENT``.

        Also called for worlds whose event has happened; the result is ignored there.

        Args:
            acting: (n,) bool, the control phase has begun.
            palm_distance_m: (n, 25) palm center to target center [m].
            contacts: of shape (n, 25), what touches the target; None if the rule uses no contact
                sensors.
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


CAPTURES: Registry[type[CaptureRule]] = Registry("capture rule", CaptureRule)


@CAPTURES.register("attach")
class Attach(CaptureRule):
    """Localized means within 3 cm; captured means localized with all joints at 0.9 to 1.2 of the
    reference grasp.

    Hand and target do not collide. Within the 25 physics steps of a frame the weld happens at the
    closest approach, so a fast target cannot slip between two frames (Appendix "Evaluation
    Criteria").
    """

    welds = True
    collides_after = 0
    expert = "intercept"
    hand = "capsule"

    def collisions(self, motion: Motion) -> int:
        """Return the environment's bit for real dynamics, none for a prescribed path."""
        return ENVIRONMENT if isinstance(motion, PhysicalMotion) else 0

    def events(
        self, acting: np.ndarray, palm_distance_m: np.ndarray, contacts: TargetContacts | None
    ) -> np.ndarray:
        """Return the closest physics step where it is within the localization radius."""
        closest = palm_distance_m.argmin(axis=1)
        inside = palm_distance_m.min(axis=1) < self.localization_radius_m
        return np.where(inside & acting, closest, NO_EVENT)

    def captured(self, track: Track) -> np.ndarray:
        """Return (T,) bool: localized, and the pose matched at the first localized frame."""
        return track.localized & self.success(track)

    def stage(self, track: Track) -> str:
        """Return ``missed``, ``localized`` or ``captured``."""
        if not track.localized.any():
            return "missed"
        return "captured" if self.success(track) else "localized"

    def success(self, track: Track) -> bool:
        """Return whether the pose matched at the first localized frame."""
        if not track.localized.any():
            return False
        joints = track.joints[track.localized.argmax()]
        return bool(in_reference_grasp(joints, track.open_joints, track.reference_joints))


@CAPTURES.register("attach_lenient")
class AttachLenient(Attach):
    """Localized means within 10 cm; weld, grasp check and R_time use the same threshold (S_loc* of
    the paper).

    Appendix "Evaluation Criteria" relaxes the threshold of localization, and attaches the target
    "once the hand-object distance meets the localization criterion".
    """

    localization_radius_m = LENIENT_RADIUS_M


@CAPTURES.register("contact")
class Contact(CaptureRule):
    """Held: gripped by thumb and finger, or finger and palm, clear of all else, for 0.5 s while the
    hand moves.

    Hand and target collide from the start. A prescribed target follows its path until the hand
    first touches it, and is a free body from that physics step on, at the velocity it had; a
    pendulum's string lets go likewise.
    """

    welds = False
    collides_after = HAND_BIT | ENVIRONMENT
    expert = "match"
    hand = "opposed"
    gantry_speed_m_s = GANTRY_SPEED_M_S
    uses_contact_sensors = True
    hold_frames = 32
    settle_frames = 40

    def collisions(self, motion: Motion) -> int:
        """Return the hand's bit, and for real dynamics the environment's; a driven path heeds no
        obstacle.
        """
        return HAND_BIT | (ENVIRONMENT if isinstance(motion, PhysicalMotion) else 0)

    def events(
        self, acting: np.ndarray, palm_distance_m: np.ndarray, contacts: TargetContacts | None
    ) -> np.ndarray:
        """Return the first physics step in which the hand touches the target."""
        assert contacts is not None
        touched = contacts.by_hand  # (n, 25)
        return np.where(touched.any(axis=1), touched.argmax(axis=1), NO_EVENT)

    def captured(self, track: Track) -> np.ndarray:
        """Return (T,) bool: the target is gripped."""
        return gripped(track)

    def stage(self, track: Track) -> str:
        """Return ``missed``, ``touched``, ``enclosed``, ``slipped`` or ``held``."""
        if self.success(track):
            return "held"
        longest = max((end - start for start, end in runs(gripped(track))), default=0)
        if longest >= SLIPPED_FRAMES:
            return "slipped"
        if longest:
            return "enclosed"
        return "touched" if track.contacts.by_hand.any() else "missed"

    def success(self, track: Track) -> bool:
        """Return whether a grip lasted long enough on a moving hand."""
        steps_m = np.linalg.norm(
            np.diff(track.palm_pos_h, axis=0, prepend=track.palm_pos_h[:1]), axis=1
        )
        travel_m = np.concatenate(
            [[0.0], np.cumsum(steps_m)]
        )  # of the palm, before each frame and at the end
        moved_m = (
            travel_m[HELD_FRAMES:] - travel_m[:-HELD_FRAMES]
        )  # from frame t to t + HELD_FRAMES
        return any(
            (moved_m[start : max(start, end + 1 - HELD_FRAMES)] >= HELD_TRAVEL_M).any()
            for start, end in runs(gripped(track))
        )


def gripped(track: Track) -> np.ndarray:
    """Return (T,) bool: between thumb and another finger, or finger and palm, near the palm center,
    off all else.
    """
    fingers = track.contacts.finger_force_n > 0
    palm = track.contacts.palm_force_n > 0
    opposed = (fingers[:, THUMB] | palm) & np.delete(fingers, THUMB, axis=1).any(axis=1)
    opposed |= fingers[:, THUMB] & palm
    return opposed & ~(track.contacts.others > 0) & (track.palm_distance_m < HELD_RADIUS_M)
