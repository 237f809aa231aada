"""Which homes keep the hand off tables, ramps and walls, while it waits and on its way to the intercept.

The hand does not collide with them, so nothing else would stop it from waiting inside a table, where its camera sees
what no real one could. Like visibility, this is decided for one reference hand, whatever hand the recipe plays.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence

import numpy as np

from dynahoi_lerobot.foundation.rotations import quat_to_matrix
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.sampling.visibility import open_reference_hand
from dynahoi_lerobot.scene.signed_distance import signed_distance

GRID_M = 0.01
"""Spacing of the points that stand for the hand; every point of it is within 9 mm of one (half a cell's diagonal)."""
POINT_CLEARANCE_M = 0.02
"""Least distance of those points from a fixture. It leaves the open hand at least 1.1 cm, the thickness of a finger's
flesh around its axis (0.85 to 0.95 cm), so that fingers do not touch the fixture as they begin to close."""
WAY_CLEARANCE_M = 0.03
"""Least distance of the palm centre from a fixture on its straight way to the intercept: the localisation radius. Where
the target itself is nearer to its table, that distance."""
WAY_POINTS = 64


def keeps_clear(homes: np.ndarray, intercept_w: np.ndarray, fixtures: Sequence[Box]) -> np.ndarray:
    """Tell from which homes neither the waiting hand nor the palm centre on its way comes too near to a fixture.

    The fingers do on the last centimetres, where the target lies on a table.

    Args:
        homes: (K, 3) positions of the palm centre [m], world.
        intercept_w: (3,) where the target is met [m], world.
        fixtures: the boxes around the motion.

    Returns:
        (K,) bool.
    """
    clear = np.ones(len(homes), bool)
    share = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
    for box in fixtures:
        hand_m = box_distance(homes[:, None] + hand_points(), box).min(axis=1)
        way_m = box_distance(homes[:, None] + share * (intercept_w - homes)[:, None], box)  # (K, P)
        allowed_m = np.minimum(WAY_CLEARANCE_M, way_m[:, -1])
        clear &= (hand_m > POINT_CLEARANCE_M) & (way_m.min(axis=1) >= allowed_m)
    return clear


def box_distance(points: np.ndarray, box: Box) -> np.ndarray:
    """Return (...) signed distance [m] of points (..., 3) [m], world, to the surface of a box, negative inside."""
    local = (points - box.pos) @ quat_to_matrix(np.asarray(box.quat))
    return signed_distance("box", local, np.asarray(box.half_size))


@functools.cache
def hand_points() -> np.ndarray:
    """(P, 3) points all over the open reference hand [m], from the palm centre: grids in its geoms' bounding boxes."""
    scene, data = open_reference_hand()
    points = []
    for geom in scene.hand_geoms:
        middle, half = np.split(scene.model.geom_aabb[geom], 2)
        lines = [np.linspace(-h, h, int(np.ceil(2 * h / GRID_M)) + 1) for h in half]
        local = middle + np.array(list(itertools.product(*lines)))
        points.append(data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T)
    return np.concatenate(points) - data.site_xpos[scene.palm_site]
