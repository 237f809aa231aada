"""Which points the camera of the waiting hand sees: those in its field of view that the hand does not hide.

Homes are chosen for one reference hand, whatever hand the recipe plays, so that every hand starts at the same place in
the same episodes. All hands carry the same camera at the same place; only what of the view they hide differs.
"""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from dynahoi_lerobot.foundation.products import product
from dynahoi_lerobot.hands.base import SKIN_GROUP
from dynahoi_lerobot.scene.scene import Scene, compile_scene

REFERENCE_HAND = "capsule"
VIEW_MARGIN = 0.92
"""Share of the half field of view, from its middle, in which a point counts as seen."""
MIN_DEPTH_M = 0.05
SILHOUETTE_SIZE = 96
"""Rays along each side of the view with which the hand's silhouette is measured."""
COLLIDING_GROUPS = np.array([group != SKIN_GROUP for group in range(mujoco.mjNGROUP)], np.uint8)
"""The silhouette is that of the hand that collides, so that homes do not depend on how the hand is drawn."""


def visible(points: np.ndarray) -> np.ndarray:
    """Tell which points the camera of the open reference hand sees.

    Args:
        points: (..., 3) relative to the palm centre [m], world axes.

    Returns:
        (...) bool.
    """
    pos, rotation, half = _camera()
    local = product(points - pos, rotation)  # x right, y up, z backwards
    depth = np.maximum(-local[..., 2], MIN_DEPTH_M)
    plane = local[..., :2] / (half * depth[..., None])  # -1 to 1 across the view
    in_view = (-local[..., 2] > MIN_DEPTH_M) & (np.abs(plane) < VIEW_MARGIN).all(axis=-1)
    column, row = np.moveaxis(((np.clip(plane, -1, 1) + 1) / 2 * (SILHOUETTE_SIZE - 1)).round().astype(int), -1, 0)
    return in_view & (np.linalg.norm(local, axis=-1) < _hand_distance()[row, column])


def _camera() -> tuple[np.ndarray, np.ndarray, float]:
    """Position (3,) [m] and rotation (3, 3) of the camera in the palm's frame, and tangent of half its view."""
    scene = compile_scene(REFERENCE_HAND)
    model, camera = scene.model, scene.camera
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.cam_quat[camera])
    return model.cam_pos[camera], rotation.reshape(3, 3), float(np.tan(np.radians(model.cam_fovy[camera]) / 2))


@functools.cache
def _hand_distance() -> np.ndarray:
    """(K, K) distance of the open hand from the camera [m], infinite beside it; rows upwards, columns rightwards."""
    scene, data = open_reference_hand()
    _, rotation, half = _camera()
    across = np.linspace(-half, half, SILHOUETTE_SIZE)
    x, y = np.meshgrid(across, across)
    rays = product(np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3), rotation.T)  # (K * K, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geom, distance = np.zeros(len(rays), np.int32), np.zeros(len(rays))
    mujoco.mj_multiRay(
        scene.model, data, data.cam_xpos[scene.camera], rays.ravel(), COLLIDING_GROUPS, True, -1, geom, distance, None,
        len(rays), mujoco.mjMAXVAL,
    )  # fmt: skip
    hit = np.isin(geom, scene.hand_geoms) & (distance >= 0)
    return np.where(hit, distance, np.inf).reshape(SILHOUETTE_SIZE, SILHOUETTE_SIZE)


def open_reference_hand() -> tuple[Scene, mujoco.MjData]:
    """Return the scene and kinematics of the open hand 1 m above the floor, with the target out of its view."""
    scene = compile_scene(REFERENCE_HAND)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos[:3]] = (0.0, 0.0, 1.0)
    data.qpos[scene.hand_qpos[3:]] = scene.hand.open_joints()
    data.qpos[scene.target_qpos : scene.target_qpos + 3] = (0.0, 0.0, 100.0)
    mujoco.mj_forward(scene.model, data)
    return scene, data
