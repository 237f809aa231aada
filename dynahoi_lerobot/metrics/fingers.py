"""Comparison of the finger joints with the reference grasp, frame by frame."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode, joints_reached
from dynahoi_lerobot.foundation.conventions import FINGERS, JOINTS_PER_FINGER


def share_of_frames(episode: Episode, at_least: int) -> float:
    """Return the share of control frames, 0 to 1, in which ``at_least`` fingers match the reference in all joints."""
    reached = joints_reached(episode.joints[episode.control], episode.open_joints, episode.reference_joints)
    by_finger = reached.reshape(-1, len(FINGERS), JOINTS_PER_FINGER)  # (T, 15) -> (T, 5, 3)
    return float(np.mean(by_finger.all(axis=2).sum(axis=1) >= at_least))


def grasps_at(episode: Episode, frames: slice) -> bool:
    """Tell whether all 15 joints reach the reference in any of ``frames``."""
    reached = joints_reached(episode.joints[frames], episode.open_joints, episode.reference_joints)
    return bool(reached.all(axis=1).any())
