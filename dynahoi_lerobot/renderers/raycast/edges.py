"""Smooth edges: pixels between two shapes take 2 x 2 samples of what is there, in the colours their neighbours have.

The samples say how much of the pixel each shape covers; the colour of a shape is that of the nearest pixel that shows
it. So a sample costs no shading, which is most of the work.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.pixel_rows import Indices, Row
from dynahoi_lerobot.renderers.raycast.render import slope, tile_of
from dynahoi_lerobot.renderers.raycast.tiling import FAR, TILE, CameraIntrinsics
from dynahoi_lerobot.renderers.raycast.tracing import Worlds, meet_shape

SAMPLES = wp.constant(4)
"""Samples of a pixel on an edge."""
GROUP = wp.constant(TILE // SAMPLES)
"""Pixels that are sampled together."""
Members = wp.types.vector(GROUP, wp.int32)
STEP = wp.constant(0.03)
"""Relative difference of depth between two shapes that makes an edge; where shapes touch, there is little to smooth."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.kernel
def smooth_edges(
    first_row: int,
    intrinsics: CameraIntrinsics,
    worlds: Worlds,
    visible: wp.array3d[Indices],
    depths: wp.array3d[Row],
    sharp: wp.array3d[wp.vec3ub],
    images: wp.array3d[wp.vec3ub],
):
    """Write the edges in one pixel row of one tile; ``images`` are copies of ``sharp``. Launched as ``trace`` is."""
    row, column = wp.tid()
    w, y = (first_row + row) // intrinsics.size, (first_row + row) % intrinsics.size
    edges = _edges(intrinsics, visible, depths, w, y, column)
    members, found = Members(), int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
    xs, ys = Row(), Row()
    for i in range(wp.min(TILE, intrinsics.size - column * TILE)):
        if edges[i] == 1:
            members[found] = i
            for k in range(SAMPLES):
                offset = _offset(k)
                xs[SAMPLES * found + k] = slope(intrinsics, column * TILE + i) + offset[0] / intrinsics.focal
                ys[SAMPLES * found + k] = -slope(intrinsics, y) + offset[1] / intrinsics.focal
            found += 1
        if found == GROUP or (found > 0 and i == TILE - 1):
            shapes = _trace_seen(intrinsics, worlds, visible, w, y, column, xs, ys)
            for j in range(found):
                images[w, y, column * TILE + members[j]] = _mean(
                    intrinsics, visible, sharp, shapes, SAMPLES * j, w, y, column * TILE + members[j]
                )
            found = 0


@wp.func
def _edges(
    intrinsics: CameraIntrinsics, visible: wp.array3d[Indices], depths: wp.array3d[Row], w: int, y: int, column: int
) -> Indices:
    """1 for each pixel of a row next to which another shape is seen at a different depth."""
    edges, shape, depth = Indices(0), visible[w, y, column], depths[w, y, column]
    up, down = wp.max(y - 1, 0), wp.min(y + 1, intrinsics.size - 1)
    above, below = visible[w, up, column], visible[w, down, column]
    depth_above, depth_below = depths[w, up, column], depths[w, down, column]
    for i in range(TILE):
        vertical = _jump(shape[i], depth[i], above[i], depth_above[i])
        edges[i] = wp.max(vertical, _jump(shape[i], depth[i], below[i], depth_below[i]))
    for i in range(TILE - 1):
        edges[i] = wp.max(edges[i], _jump(shape[i], depth[i], shape[i + 1], depth[i + 1]))
    for i in range(1, TILE):
        edges[i] = wp.max(edges[i], _jump(shape[i], depth[i], shape[i - 1], depth[i - 1]))
    before, behind = wp.max(column - 1, 0), wp.min(column + 1, visible.shape[2] - 1)
    first, last = visible[w, y, behind][0], visible[w, y, before][TILE - 1]
    if column > 0:
        edges[0] = wp.max(edges[0], _jump(shape[0], depth[0], last, depths[w, y, before][TILE - 1]))
    if column < behind:
        end = TILE - 1
        edges[end] = wp.max(edges[end], _jump(shape[end], depth[end], first, depths[w, y, behind][0]))
    return edges


@wp.func
def _jump(shape: int, depth: float, other: int, other_depth: float) -> int:
    """1 if two pixels show shapes at different depths."""
    return wp.where(shape != other and wp.abs(depth - other_depth) > STEP * wp.min(depth, other_depth), 1, 0)


@wp.func
def _offset(sample: int) -> wp.vec2:
    """Where a sample lies from a pixel's middle [px]: a grid of 2 x 2, turned so that no two share row or column."""
    x = wp.where(sample < 2, 0.125, 0.375)
    y = wp.where(sample < 2, 0.375, -0.125)
    return wp.where(sample % 2 == 0, wp.vec2(x, y), wp.vec2(-x, -y))


@wp.func
def _mean(
    intrinsics: CameraIntrinsics,
    visible: wp.array3d[Indices],
    sharp: wp.array3d[wp.vec3ub],
    shapes: Indices,
    first: int,
    w: int,
    y: int,
    x: int,
) -> wp.vec3ub:
    """Mean colour of four samples of a pixel, which show ``shapes`` from number ``first`` on."""
    red, green, blue = int(2), int(2), int(2)  # noqa: RUF046, UP018 - they vary; two, to round to the nearest
    for k in range(SAMPLES):
        at = _pixel_that_shows(intrinsics, visible, shapes[first + k], w, y, x)
        color = sharp[w, at[0], at[1]]
        red += int(color[0])
        green += int(color[1])
        blue += int(color[2])
    return wp.vec3ub(wp.uint8(red // SAMPLES), wp.uint8(green // SAMPLES), wp.uint8(blue // SAMPLES))


@wp.func
def _pixel_that_shows(
    intrinsics: CameraIntrinsics, visible: wp.array3d[Indices], shape: int, w: int, y: int, x: int
) -> wp.vec2i:
    """Row and column of the pixel itself if it shows the shape, else of a neighbour that does, else of itself."""
    if visible[w, y, x // TILE][x % TILE] == shape:
        return wp.vec2i(y, x)
    if y > 0 and visible[w, y - 1, x // TILE][x % TILE] == shape:
        return wp.vec2i(y - 1, x)
    if y + 1 < intrinsics.size and visible[w, y + 1, x // TILE][x % TILE] == shape:
        return wp.vec2i(y + 1, x)
    if x > 0 and visible[w, y, (x - 1) // TILE][(x - 1) % TILE] == shape:
        return wp.vec2i(y, x - 1)
    if x + 1 < intrinsics.size and visible[w, y, (x + 1) // TILE][(x + 1) % TILE] == shape:
        return wp.vec2i(y, x + 1)
    return wp.vec2i(y, x)


@wp.func
def _trace_seen(
    intrinsics: CameraIntrinsics,
    worlds: Worlds,
    visible: wp.array3d[Indices],
    w: int,
    y: int,
    column: int,
    xs: Row,
    ys: Row,
) -> Indices:
    """The nearest shape along each ray, of those that the row or one beside it shows."""
    depths, nearest, tile = Row(FAR), Indices(-1), tile_of(intrinsics, y, column)
    here, above = visible[w, y, column], visible[w, wp.max(y - 1, 0), column]
    below = visible[w, wp.min(y + 1, intrinsics.size - 1), column]
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        seen = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            seen = wp.max(seen, wp.where(here[i] == s or above[i] == s or below[i] == s, 1, 0))
        if seen == 1:
            depths, nearest = meet_shape(worlds.shapes[w, s], s, depths, nearest, xs, ys)
    return nearest
