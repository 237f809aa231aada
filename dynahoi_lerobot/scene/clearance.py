"""Room around the open hand: whether it waits and goes its way clear of boxes, for one reference
hand.

Which hand the recipe plays does not matter, so that every hand starts at the same place in the same
episodes.
"""

import functools
import itertools
from collections.abc import Sequence

import mujoco
import numpy as np

from dynahoi_lerobot.core.numerics import product, quat_to_matrix
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.scene.scene import Scene, compile_scene
from dynahoi_lerobot.scene.signed_distance import signed_distance

REFERENCE_HAND = "capsule"
GRID_M = 0.01
"""Spacing of the points that stand for the hand; every point of it is within 9 mm of one (half a
cell's diagonal)."""
POINT_CLEARANCE_M = 0.02
"""Least distance of those points from a fixture. It leaves the open hand at least 1.1 cm, the
thickness of a finger's flesh around its axis (0.85 to 0.95 cm), so that fingers do not touch the
fixture as they begin to close."""
WAY_CLEARANCE_M = 0.03
"""Least distance of the palm center from a fixture on its straight way to the intercept: the
localization radius. Where the target itself is nearer to its table, that distance."""
WAY_POINTS = 64


def open_reference_hand() -> tuple[Scene, mujoco.MjData]:
    """Return the scene and kinematics of the open hand 1 m above the floor, with the target out of
    its view.
    """
    scene = compile_scene(REFERENCE_HAND)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos[:3]] = (0.0, 0.0, 1.0)
    data.qpos[scene.hand_qpos[3:]] = scene.hand.open_joints()
    data.qpos[scene.target_qpos : scene.target_qpos + 3] = (0.0, 0.0, 100.0)
    mujoco.mj_forward(scene.model, data)
    return scene, data


def keeps_clear(homes: np.ndarray, intercept_w: np.ndarray, fixtures: Sequence[Box]) -> np.ndarray:
    """Tell from which homes neither the waiting hand nor the palm center on its way comes too near
    to a fixture.

    The fingers do on the last centimeters, where the target lies on a table.

    Args:
        homes: (K, 3) positions of the palm center [m], world.
        intercept_w: (3,) where the target is met [m], world.
        fixtures: the boxes around the motion.

    Returns:
        (K,) bool.
    """
    clear = np.ones(len(homes), bool)
    share = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
    for box in fixtures:
        left = homes[clear]
        way_m = box_distance(left[:, None] + share * (intercept_w - left)[:, None], box)  # (k, P)
        fits = way_m.min(axis=1) >= np.minimum(WAY_CLEARANCE_M, way_m[:, -1])
        fits[fits] = (
            box_distance(left[fits][:, None] + hand_points(), box).min(axis=1) > POINT_CLEARANCE_M
        )
        clear[clear] = fits
    return clear


def box_distance(points: np.ndarray, box: Box) -> np.ndarray:
    """Return (...) signed distance [m] of points (..., 3) [m], world, to the surface of a box,
    negative inside.
    """
    local = product(points - box.pos, quat_to_matrix(np.asarray(box.quat)))
    return signed_distance("box", local, np.asarray(box.half_size))


@functools.cache
def hand_points() -> np.ndarray:
    """(P, 3) points all over the open reference hand [m], from the palm center: grids in its geoms'
    bounding boxes.
    """
    scene, data = open_reference_hand()
    points = []
    for geom in scene.hand_geoms:
        middle, half = np.split(scene.model.geom_aabb[geom], 2)
        lines = [np.linspace(-h, h, int(np.ceil(2 * h / GRID_M)) + 1) for h in half]
        local = middle + np.array(list(itertools.product(*lines)))
        points.append(data.geom_xpos[geom] + product(local, data.geom_xmat[geom].reshape(3, 3).T))
    return np.concatenate(points) - data.site_xpos[scene.palm_site]
