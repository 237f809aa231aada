"""The paper's rule: a target within the localisation radius is welded to the hand; the grasp is a matter of pose.

Hand and target do not collide. Within the 25 physics steps of a frame the weld happens at the closest approach, so a
fast target cannot slip between two frames (Appendix "Evaluation Criteria"). The lenient rule is the track on which the
paper evaluates vision-language models: a threshold of 1.0 u.
"""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.captures.base import CAPTURES, NO_EVENT, CaptureRule, Substeps, Track, Weld
from dynahoi_lerobot.episode import joints_reached
from dynahoi_lerobot.foundation.conventions import LENIENT_RADIUS_M
from dynahoi_lerobot.motions import Motion, PhysicalMotion
from dynahoi_lerobot.scene.model import ENVIRONMENT


@CAPTURES.register("attach")
class Attach(CaptureRule):
    """Localised means within 3 cm; captured means localised with all 15 joints at 0.9 of the reference grasp."""

    name = "attach"
    effect = Weld()
    expert = "intercept"
    hand = "capsule"

    def collisions(self, motion: Motion) -> int:
        """Return the environment's bit for real dynamics, none for a prescribed path."""
        return ENVIRONMENT if isinstance(motion, PhysicalMotion) else 0

    def events(self, substeps: Substeps) -> np.ndarray:
        """Return the closest physics step where it is within the localisation radius."""
        closest = substeps.palm_distance.argmin(axis=1)
        inside = substeps.palm_distance.min(axis=1) < self.localization_radius_m
        return np.where(inside & substeps.acting, closest, NO_EVENT)

    def captured(self, track: Track) -> np.ndarray:
        """Return (T,) bool: localised, and the pose matched at the first localised frame."""
        return track.localized & self.success(track)

    def stage(self, track: Track) -> str:
        """Return ``missed``, ``localized`` or ``captured``."""
        if not track.localized.any():
            return "missed"
        return "captured" if self.success(track) else "localized"

    def success(self, track: Track) -> bool:
        """Return whether the pose matched at the first localised frame."""
        if not track.localized.any():
            return False
        joints = track.joints[track.localized.argmax()]
        return bool(joints_reached(joints, track.open_joints, track.reference_joints).all())


@CAPTURES.register("attach_lenient")
class AttachLenient(Attach):
    """Localised means within 10 cm; the weld, the grasp's verdict and the clock of R_time follow (S_loc* of the paper).

    Appendix "Evaluation Criteria" relaxes the threshold of localisation, and attaches the target "once the hand-object
    distance meets the localization criterion".
    """

    name = "attach_lenient"
    localization_radius_m = LENIENT_RADIUS_M
