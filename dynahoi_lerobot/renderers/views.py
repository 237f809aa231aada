"""Views: pictures that an episode may hold besides those of the hand's camera, all of them square, RGB and 8 bit.

A view is a camera, or what a camera shows otherwise: ``side``, ``ego_depth``, ``side_segmentation``. Every LeRobot
policy takes such pictures, and every codec stores them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.renderers.base import Renderer
from dynahoi_lerobot.scene.scene import SIDE_CAMERA, Scene

CAMERAS = (EGO_CAMERA, SIDE_CAMERA)
DEPTH_LEVEL_M = 0.01
"""Depth per grey level; what is 2.55 m away or further is white, as is what is nowhere."""
FARTHEST_LEVEL = 255
COLORS = {"nothing": (0, 0, 0), "surroundings": (70, 70, 70), "fixture": (60, 90, 220), "hand": (60, 200, 80)}
COLORS |= {"target": (230, 50, 50)}
"""What a segmentation paints things with."""


def color(renderer: Renderer, ids: np.ndarray) -> np.ndarray:
    """Return (n, H, W, 3) uint8, what the camera sees."""
    return renderer.rgb(ids)


def depth(renderer: Renderer, ids: np.ndarray) -> np.ndarray:
    """Return (n, H, W, 3) uint8, grey: one level per centimetre along the camera's axis."""
    depth_m = renderer.depth(ids)  # (n, H, W)
    levels = np.where(depth_m > 0.0, np.minimum(depth_m / DEPTH_LEVEL_M, FARTHEST_LEVEL), FARTHEST_LEVEL)
    return np.repeat(levels.astype(np.uint8)[..., None], 3, axis=-1)


def segmentation(renderer: Renderer, ids: np.ndarray) -> np.ndarray:
    """Return (n, H, W, 3) uint8, ``COLORS`` of what the camera sees."""
    return _palette(renderer.scene)[renderer.segmentation(ids)]  # -1 takes the last row


SHOWS: dict[str, Callable[[Renderer, np.ndarray], np.ndarray]] = {
    "": color,
    "_depth": depth,
    "_segmentation": segmentation,
}
"""What a view shows, by the end of its name."""

VIEWS = {camera + shows: (camera, draw) for camera in CAMERAS for shows, draw in SHOWS.items()}
"""By name: the camera, and how it is drawn. ``ego`` is the hand's camera itself, which is always there."""


FURTHER_VIEWS = tuple(name for name in VIEWS if name != EGO_CAMERA)


def check_views(names: tuple[str, ...]) -> None:
    """Refuse views that do not exist or that are named twice.

    Raises:
        ValueError: naming the view received and the ones there are.
    """
    for name in names:
        if name not in FURTHER_VIEWS:
            raise ValueError(f"unknown view {name!r}; known besides {EGO_CAMERA!r}: {', '.join(FURTHER_VIEWS)}")
    if len(set(names)) < len(names):
        raise ValueError(f"each view may be named once, got {', '.join(names)}")


def _palette(scene: Scene) -> np.ndarray:
    """(ngeom + 1, 3) colour of each geom, and at the end that of nothing."""
    palette = np.full((scene.model.ngeom + 1, 3), COLORS["surroundings"], np.uint8)
    striker_and_string = [scene.striker_geom, scene.tether_geom]
    palette[[*scene.box_geoms, *striker_and_string]] = COLORS["fixture"]
    palette[scene.hand_geoms] = COLORS["hand"]
    palette[scene.target_geoms] = COLORS["target"]
    palette[-1] = COLORS["nothing"]
    return palette
