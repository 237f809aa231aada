"""Where a screen may stand: off the hand on its way, its camera, the target, and all that belongs to the motion."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.foundation.rotations import quat_to_matrix
from dynahoi_lerobot.hands.gantry import CAMERA_POS
from dynahoi_lerobot.motions.launch import Box, Launch
from dynahoi_lerobot.sampling.fixture_clearance import box_distance, hand_points, keeps_clear

CAMERA_CLEARANCE_M, TARGET_CLEARANCE_M, FIXTURE_CLEARANCE_M = 0.02, 0.01, 0.01
"""Least distances of a screen from the camera, and from the surfaces of target, fixtures, string and striker."""
WAY_POINTS, STRING_POINTS = 8, 24


def stands_clear(panel: Box, spec: EpisodeSpec, meeting: int, radius_m: float) -> bool:
    """Tell whether a panel across x stands in nobody's way.

    Args:
        panel: the screen.
        spec: the episode.
        meeting: frame at which a fast hand meets the target; all of the open hand keeps clear on its way there, and the
            palm centre also on the way to the episode's intercept.
        radius_m: of a sphere around the target [m].
    """
    home, launch = spec.home_pos_w, spec.motion.launch(spec.target)
    return (
        bool(box_distance(spec.oracle_path, panel).min() > radius_m + TARGET_CLEARANCE_M)
        and all(apart(panel, box, FIXTURE_CLEARANCE_M) for box in launch.boxes)
        and _clear_of_string(panel, launch, spec.oracle_path)
        and _clear_of_striker(panel, launch, spec.intercept_frame)
        and _clear_of_hand(panel, home, spec.oracle_path[meeting], hand_points())
        and _clear_of_hand(panel, home, spec.intercept_pos_w, np.zeros((1, 3)))
    )


def _clear_of_hand(panel: Box, home_w: np.ndarray, goal_w: np.ndarray, points: np.ndarray) -> bool:
    """Tell whether a panel is off the waiting hand, and off palm centre and camera on a straight way.

    The palm centre keeps as far from it as from fixtures; ``points`` (P, 3) of the hand must not be in it.
    """
    way = home_w + np.linspace(0.0, 1.0, WAY_POINTS)[:, None] * (goal_w - home_w)
    return (
        bool(keeps_clear(home_w[None], goal_w, [panel]).all())
        and bool(box_distance(way + CAMERA_POS, panel).min() > CAMERA_CLEARANCE_M)
        and bool(box_distance(way[:, None] + points, panel).min() > 0.0)
    )


def _clear_of_string(panel: Box, launch: Launch, path_w: np.ndarray) -> bool:
    if launch.tether is None:
        return True
    share = np.linspace(0.0, 1.0, STRING_POINTS)[:, None]
    string = path_w[:, None] + share * (np.asarray(launch.tether.anchor) - path_w[:, None])  # (F, P, 3)
    return bool(box_distance(string, panel).min() > FIXTURE_CLEARANCE_M)


def _clear_of_striker(panel: Box, launch: Launch, frames: int) -> bool:
    if (striker := launch.striker) is None:
        return True
    times = np.arange(frames + 1)[:, None] * CONTROL_DT
    balls = np.asarray(striker.pos) + times * np.asarray(striker.velocity)
    return bool(box_distance(balls, panel).min() > striker.radius_m + FIXTURE_CLEARANCE_M)


def apart(panel: Box, other: Box, room_m: float) -> bool:
    """Tell whether an upright box across x is so far [m] from another box, by the axes that may separate them."""
    turned = quat_to_matrix(np.asarray(other.quat, float))
    edges = np.cross(np.eye(3)[:, None], turned.T[None]).reshape(-1, 3)
    axes = np.concatenate([np.eye(3), turned.T, edges])
    axes = axes[np.linalg.norm(axes, axis=1) > 1e-6]
    reach = np.abs(axes) @ (np.asarray(panel.half_size) + room_m) + np.abs(axes @ turned) @ np.asarray(other.half_size)
    return bool((np.abs(axes @ (np.asarray(panel.pos) - np.asarray(other.pos))) > reach).any())
