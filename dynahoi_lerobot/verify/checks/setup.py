"""Cameras, limits of the hand and the expert's plan are those of hand, image size, control class and motion."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.conventions import CONTROL_DT, DEFAULT_IMAGE_SIZE_PX
from dynahoi_lerobot.core.rules import control_class_of
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.motions import PrescribedMotion
from dynahoi_lerobot.rollout.recorder import camera_pose, intrinsics
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.scene.model import SIDE_CAMERA
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns
from dynahoi_lerobot.verify.stored_motion import stored_motion

TOLERANCE = 1e-4
"""Of numbers in float32, absolute [m, px, m/s, s]."""
STRAIGHT = "intercept"
"""The expert that plans to be where the target is."""


@CHECKS.register("setup")
class Setup(Check):
    """Computes cameras and limits again; a plan meets a target of a prescribed path on it. Needs the recipe."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield constants that the recipe does not give, and a plan that leads elsewhere."""
        if (recipe := dataset.recipe) is None:
            return
        where = f"episode {row['episode_index']}"
        size = recipe.image_size or DEFAULT_IMAGE_SIZE_PX
        known = _cameras(compile_scene(recipe.hand).model, size) | {"hand_limits": _limits(recipe)}
        for name, wanted in known.items():
            found = np.asarray(row[f"stats/{name}"], float)
            if found.shape != wanted.shape or np.abs(found - wanted).max() > TOLERANCE:
                yield f"{where}: {name} is {found.round(3).tolist()}; the recipe gives {wanted.round(3).tolist()}"
        if problem := _plan(row):
            yield f"{where}: {problem}"


def _cameras(model: mujoco.MjModel, image_size: int) -> dict[str, np.ndarray]:
    """Return poses and intrinsics of both cameras by name of their column."""
    return {
        "ego_camera": camera_pose(model, EGO_CAMERA),
        "side_camera": camera_pose(model, SIDE_CAMERA),
        "ego_intrinsics": intrinsics(model, EGO_CAMERA, image_size),
        "side_intrinsics": intrinsics(model, SIDE_CAMERA, image_size),
    }


def _limits(recipe: Recipe) -> np.ndarray:
    """Return (3,) limits of palm [m/s] and joints [rad/s], latency [ms]."""
    control = control_class_of(recipe.control_class)
    return np.array([CAPTURES[recipe.capture].palm_speed_m_s(control), control.joint_speed_rad_s, control.latency_ms])


def _plan(row: EpisodeRow) -> str | None:
    """Find a lead time that is no number of frames, and a plan of the expert that does not lead to the target."""
    speed, lead_s = row["stats/first_plan"]
    frames = round(lead_s / CONTROL_DT)
    if speed < 0 or frames < 0 or abs(frames * CONTROL_DT - lead_s) > TOLERANCE:
        return f"first_plan is {speed:.3f} m/s for {lead_s:.3f} s; neither is negative, and frames last {CONTROL_DT} s"
    motion = stored_motion(row["motion"], row["parameters"])
    if row["agent"] != STRAIGHT or not isinstance(motion, PrescribedMotion):
        return None
    meeting_w = motion.position(np.array([(row["window_frames"] + frames) * CONTROL_DT]))[0]
    way_m = float(np.linalg.norm(meeting_w - row["stats/home_position"]))
    if abs(way_m - speed * lead_s) <= TOLERANCE and frames > 0:
        return None
    return f"first_plan is {speed:.3f} m/s for {lead_s:.2f} s; the target is {way_m:.3f} m from home then"
