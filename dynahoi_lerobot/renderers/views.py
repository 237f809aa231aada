"""Camera views that an episode may record: a camera and a modality, as square 8-bit RGB images.

``ego`` is the hand's camera and is always recorded; ``side``, ``ego_depth`` or
``side_segmentation`` are options. Depth and segmentation are encoded as RGB too, so that every
policy can take them.
"""

from collections.abc import Callable

import numpy as np

from dynahoi_lerobot.core.conventions import DEPTH, EGO_VIEW, SEGMENTATION
from dynahoi_lerobot.renderers.base import Renderer
from dynahoi_lerobot.scene.model import SIDE_CAMERA
from dynahoi_lerobot.scene.scene import Scene

CAMERAS = (EGO_VIEW, SIDE_CAMERA)
DEPTH_LEVEL_M = 0.01
"""Depth per gray level [m]; 2.55 m and more is white, as is a ray that hits nothing."""
FARTHEST_LEVEL = 255
COLORS = {
    "nothing": (0, 0, 0),
    "surroundings": (70, 70, 70),
    "fixture": (60, 90, 220),
    "hand": (60, 200, 80),
}
COLORS |= {"target": (230, 50, 50)}
"""RGB of each class in a segmentation image."""


def depth(renderer: Renderer, ids: np.ndarray) -> np.ndarray:
    """Return depth along the optical axis as (n, H, W, 3) uint8 gray images, one level per
    centimeter.
    """
    depth_m = renderer.depth(ids)  # (n, H, W)
    levels = np.where(
        depth_m > 0.0, np.minimum(depth_m / DEPTH_LEVEL_M, FARTHEST_LEVEL), FARTHEST_LEVEL
    )
    return np.repeat(levels.astype(np.uint8)[..., None], 3, axis=-1)


def segmentation(renderer: Renderer, ids: np.ndarray) -> np.ndarray:
    """Return (n, H, W, 3) uint8 images in the ``COLORS`` of the visible classes."""
    return _palette(renderer.scene)[renderer.segmentation(ids)]  # -1 takes the last row


MODALITIES: dict[str, Callable[[Renderer, np.ndarray], np.ndarray]] = {
    "": lambda renderer, ids: renderer.rgb(ids),
    DEPTH: depth,
    SEGMENTATION: segmentation,
}
"""Function that renders a modality, by the suffix of the view's name."""

VIEWS = {
    camera + suffix: (camera, draw) for camera in CAMERAS for suffix, draw in MODALITIES.items()
}
"""Camera and rendering function of every view, by name."""

EXTRA_VIEWS = tuple(name for name in VIEWS if name != EGO_VIEW)
"""Views that are rendered only if asked for."""

MOTION_VIEW = EGO_VIEW + "_motion"
"""Gray images of the hand's camera now, two and four frames ago in the three channels, for policies
that take one frame; it is composed from ``ego`` and costs no rendering."""
OPTIONAL_VIEWS = (*EXTRA_VIEWS, MOTION_VIEW)
"""Views that episodes have only if asked for."""


def _palette(scene: Scene) -> np.ndarray:
    """(ngeom + 1, 3) uint8 class color of each geom id; the last row is for a ray that hits
    nothing.
    """
    palette = np.full((scene.model.ngeom + 1, 3), COLORS["surroundings"], np.uint8)
    striker_and_string = [scene.striker_geom, scene.tether_geom]
    palette[[*scene.box_geoms, *striker_and_string]] = COLORS["fixture"]
    palette[np.concatenate([scene.hand_geoms, scene.skin_geoms, scene.sleeve_geoms])] = COLORS[
        "hand"
    ]
    palette[scene.target_geoms] = COLORS["target"]
    palette[-1] = COLORS["nothing"]
    return palette
