"""What is the same in every frame of an episode: object, cameras, limits of the hand, the expert's plan."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from dynahoi_lerobot.agent import Meeting
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.foundation.products import norm
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.motions import Motion
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.objects.primitives import as_table, extent
from dynahoi_lerobot.scene.model import SIDE_CAMERA
from dynahoi_lerobot.world.batch import WorldBatch


def episode_constants(batch: WorldBatch, spec: EpisodeSpec, meeting: Meeting | None) -> dict[str, Any]:
    """Return what does not change in an episode that ``batch`` played, by name in ``Episode``.

    Args:
        batch: the worlds, which share hand, cameras and control class.
        spec: the episode.
        meeting: what the actor planned at control start.
    """
    model = batch.scene.model
    return object_constants(spec.motion, spec.target) | {
        "home_position": spec.home_pos_w,
        "intercept_position": spec.intercept_pos_h,
        "open_joints": spec.open_joints,
        "reference_joints": spec.reference_joints,
        "ego_camera": camera_pose(model, EGO_CAMERA),
        "side_camera": camera_pose(model, SIDE_CAMERA),
        "ego_intrinsics": intrinsics(model, EGO_CAMERA, batch.cameras.image_size),
        "side_intrinsics": intrinsics(model, SIDE_CAMERA, batch.cameras.image_size),
        "hand_limits": [batch.palm_speed_m_s, batch.control.joint_speed_rad_s, batch.control.latency_ms],
        "first_plan": planned_speed_and_lead_time(spec, meeting),
    }


def object_constants(motion: Motion, target: TargetObject) -> dict[str, Any]:
    """Return what is known of the target besides its motion; SI units."""
    launch = motion.launch(target)
    own = target.friction if launch.friction is None else launch.friction
    struck = () if launch.striker is None else (launch.striker,)
    return {
        "object_primitives": as_table(target.primitives),
        "object_size": extent(target.primitives),
        "object_mass": target.mass_kg,
        "object_inertia": target.inertia,
        # of two that touch, the greater counts
        "object_friction": [target.friction, max(own, *(box.friction for box in launch.boxes), 0.0)],
        "object_restitution": max(launch.restitution, *(body.restitution for body in (*launch.boxes, *struck)), 0.0),
    }


def camera_pose(model: mujoco.MjModel, camera: str) -> np.ndarray:
    """Return (7,) position [m] and quaternion wxyz of a camera in the frame of the body it is fixed to.

    The hand's camera is fixed to the palm, which does not turn and has its origin at the palm centre; the side camera
    to a body that is put where the palm centre waits.
    """
    found = model.camera(camera)
    return np.concatenate([found.pos, found.quat])


def intrinsics(model: mujoco.MjModel, camera: str, image_size: int) -> np.ndarray:
    """Return (4,) focal lengths fx and fy and principal point cx and cy [px] in square images of that side [px].

    The centre of the first pixel is at (0.5, 0.5).
    """
    half = image_size / 2
    focal = half / np.tan(np.radians(float(model.camera(camera).fovy[0])) / 2)
    return np.array([focal, focal, half, half])


def planned_speed_and_lead_time(spec: EpisodeSpec, meeting: Meeting | None) -> tuple[float, float]:
    """Return what a plan at control start amounts to, as the paper's ``moveSpeed`` (Appendix "Data collection").

    Returns:
        The palm's straight way from home to the meeting over the time to it [m/s], and this time [s]; zeros for no
        plan.
    """
    if meeting is None:
        return 0.0, 0.0
    lead_s = (meeting.frame - spec.window_frames) * CONTROL_DT
    return norm(meeting.palm_pos_w - spec.home_pos_w) / lead_s, lead_s
