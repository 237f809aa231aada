"""The physical rule: nothing is ever attached; a catch is what friction and the fingers hold while the hand moves.

Hand and target collide from the start. A prescribed target follows its path until the hand first touches it, and is a
free body from that physics step on, at the velocity it had; a pendulum's string lets go likewise.
"""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.captures.base import CAPTURES, NO_EVENT, CaptureRule, Release, Substeps, Track
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ, FINGERS, GANTRY_SPEED_M_S
from dynahoi_lerobot.motions import Motion, PhysicalMotion
from dynahoi_lerobot.scene.model import ENVIRONMENT, HAND_BIT

HELD_FRAMES = CONTROL_HZ // 2
"""A grip counts once it has lasted half a second."""
HELD_RADIUS_M = 0.05
"""The target's centre stays this close to the palm centre."""
HELD_TRAVEL_M = 0.05
"""The palm moves this far meanwhile, or whatever rests on a still hand would be held."""
SLIPPED_FRAMES = 3
"""A grip that lasted this long, and not long enough, was lost."""
THUMB = FINGERS.index("thumb")


@CAPTURES.register("contact")
class Contact(CaptureRule):
    """Held: gripped by thumb and finger, or finger and palm, off everything else, for 0.5 s in which the hand moves."""

    name = "contact"
    effect = Release(HAND_BIT | ENVIRONMENT)
    expert = "match"
    hand = "opposed"
    gantry_speed_m_s = GANTRY_SPEED_M_S
    uses_contact_sensors = True
    hold_frames = 32
    settle_frames = 40

    def collisions(self, motion: Motion) -> int:
        """Return the hand's bit, and for real dynamics the environment's; a driven path heeds no obstacle."""
        return HAND_BIT | (ENVIRONMENT if isinstance(motion, PhysicalMotion) else 0)

    def events(self, substeps: Substeps) -> np.ndarray:
        """Return the first physics step in which the hand touches the target."""
        assert substeps.contacts is not None
        touched = substeps.contacts.by_hand  # (n, 25)
        return np.where(touched.any(axis=1), touched.argmax(axis=1), NO_EVENT)

    def captured(self, track: Track) -> np.ndarray:
        """Return (T,) bool: the target is gripped."""
        return gripped(track)

    def stage(self, track: Track) -> str:
        """Return ``missed``, ``touched``, ``enclosed``, ``slipped`` or ``held``."""
        if self.success(track):
            return "held"
        longest = max((end - start for start, end in _runs(gripped(track))), default=0)
        if longest >= SLIPPED_FRAMES:
            return "slipped"
        if longest:
            return "enclosed"
        return "touched" if track.contacts.by_hand.any() else "missed"

    def success(self, track: Track) -> bool:
        """Return whether a grip lasted long enough on a moving hand."""
        steps_m = np.linalg.norm(np.diff(track.palm_pos_h, axis=0, prepend=track.palm_pos_h[:1]), axis=1)
        travel_m = np.concatenate([[0.0], np.cumsum(steps_m)])  # of the palm, before each frame and at the end
        moved_m = travel_m[HELD_FRAMES:] - travel_m[:-HELD_FRAMES]  # from frame t to t + HELD_FRAMES
        return any(
            (moved_m[start : max(start, end + 1 - HELD_FRAMES)] >= HELD_TRAVEL_M).any()
            for start, end in _runs(gripped(track))
        )


def gripped(track: Track) -> np.ndarray:
    """Return (T,) bool: between thumb and another finger, or finger and palm, near the palm centre, off all else."""
    fingers, palm = track.contacts.finger_force_n > 0, track.contacts.palm_force_n > 0
    opposed = (fingers[:, THUMB] | palm) & np.delete(fingers, THUMB, axis=1).any(axis=1)
    opposed |= fingers[:, THUMB] & palm
    return opposed & ~(track.contacts.others > 0) & (track.palm_distance < HELD_RADIUS_M)


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Return the (start, end) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
