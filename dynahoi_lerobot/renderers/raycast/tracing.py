"""The nearest shape along each ray of a row."""

# ruff: noqa: PLR0917 - warp functions take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.pixel_rows import enter_row
from dynahoi_lerobot.renderers.raycast.tiling import FAR, TILE, Indices, Row, Shape

TIE = wp.constant(1.0e-6)
"""Relative depth difference below which the later of two geoms is visible, as in MuJoCo."""
MISSED = wp.constant(1.0e30)
"""Depth of what is not met: beyond all others."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class LightFrame:
    """A world's light frame, whose z axis points towards the light.

    Attributes:
        camera: position of the camera [m].
        from_camera: rotation from the camera's axes.
        spread: angular radius of the light [rad].
    """

    camera: wp.vec3
    from_camera: wp.mat33
    spread: float


@wp.struct
class Worlds:
    """What there is in each world of a batch, and in which tiles of its image.

    Attributes:
        shapes: (N, S) shapes.
        lists, counts: (N, tiles, S) shapes that a tile may show, and (N, tiles) how many.
        casters, caster_counts: shapes that may shade what a tile shows, likewise.
        caster_lows, caster_highs: (N, S) corners of boxes around the shapes that cast shadows [m], light frame.
        light_frames: (N,) light frames.
        diffuse, specular: (N, lights) colours of the light, of which the first counts.
    """

    shapes: wp.array2d[Shape]
    lists: wp.array3d[int]
    counts: wp.array2d[int]
    casters: wp.array3d[int]
    caster_counts: wp.array2d[int]
    caster_lows: wp.array2d[wp.vec3]
    caster_highs: wp.array2d[wp.vec3]
    light_frames: wp.array[LightFrame]
    diffuse: wp.array2d[wp.vec3]
    specular: wp.array2d[wp.vec3]


@wp.func
def trace_row(worlds: Worlds, w: int, tile: int, xs: Row, ys: Row, least_alpha: float) -> tuple[Row, Indices]:
    """Return depth [m] and index of the nearest shape (-1 for none) whose alpha is at least ``least_alpha``."""
    depths = Row(FAR)
    visible = Indices(-1)
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        if worlds.shapes[w, s].alpha >= least_alpha:
            depths, visible = meet_shape(worlds.shapes, w, s, depths, visible, xs, ys)
    return depths, visible


@wp.func
def meet_shape(
    shapes: wp.array2d[Shape], w: int, s: int, depths: Row, visible: Indices, xs: Row, ys: Row
) -> tuple[Row, Indices]:
    """Return depths and indices with those of shape ``s`` where it is nearer."""
    row = enter_row(shapes, w, s, xs, ys)
    nearest, seen = Row(), Indices()
    for i in range(TILE):
        limit = depths[i] + TIE * wp.max(depths[i], 1.0)
        ahead = wp.where(row[i] > 0.0, row[i], MISSED)
        nearest[i] = wp.where(ahead <= limit, row[i], depths[i])
        seen[i] = wp.where(ahead <= limit, s, visible[i])
    return nearest, seen
