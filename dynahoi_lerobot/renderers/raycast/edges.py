"""Smooth edges: pixels between two shapes take 2 x 2 samples of what is there, in the colours their neighbours have.

The samples say how much of the pixel each shape covers; the colour of a shape is that of the nearest pixel that shows
it. So a sample costs no shading, which is most of the work.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.render import slope, tile_of, write_row
from dynahoi_lerobot.renderers.raycast.tiling import FAR, TILE, CameraIntrinsics, Indices, Row
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
    colors: wp.array3d[Indices],
    images: wp.array3d[wp.uint32],
):
    """Smooth the edges in one pixel row of one tile of the images.

    Launched as ``trace`` is, after ``colors`` (0xBBGGRR) and ``images`` are written.
    """
    row, column = wp.tid()
    w, y = (first_row + row) // intrinsics.size, (first_row + row) % intrinsics.size
    y_above, y_below = wp.max(y - 1, 0), wp.min(y + 1, intrinsics.size - 1)
    before, behind = wp.max(column - 1, 0), wp.min(column + 1, visible.shape[2] - 1)
    here = visible[w, y, column] + Indices(0)  # a sum is a copy; what is read of an array is read again at every use
    above, below = visible[w, y_above, column] + Indices(0), visible[w, y_below, column] + Indices(0)
    left, right = (
        visible[w, y, before][wp.where(column > 0, TILE - 1, 0)],
        visible[w, y, behind][wp.where(behind > column, 0, TILE - 1)],
    )
    if _all_alike(here, above, below, left, right) == 0:
        near = _sides_row(
            here, depths[w, y, column], left, depths[w, y, before][TILE - 1], right, depths[w, y, behind][0]
        )
        near = _jumps_row(near, here, depths[w, y, column], above, depths[w, y_above, column])
        edges = _jumps_row(near, here, depths[w, y, column], below, depths[w, y_below, column])
        if wp.max(edges) == 1:
            write_row(
                images, w, y, column, _smooth_row(intrinsics, worlds, colors, edges, here, above, below, w, y, column)
            )


@wp.func
def _all_alike(here: Indices, above: Indices, below: Indices, left: int, right: int) -> int:
    """1 if all pixels of a row and all beside it show one shape."""
    shape, different = here[0], Indices()
    for i in range(TILE):
        different[i] = (here[i] ^ shape) | (above[i] ^ shape) | (below[i] ^ shape)
    others = (left ^ shape) | (right ^ shape)
    for i in range(TILE):
        others |= different[i]
    return wp.where(others == 0, 1, 0)


@wp.func
def _jumps_row(edges: Indices, here: Indices, depth: Row, other: Indices, other_depth: Row) -> Indices:
    """Add the pixels that show another shape at another depth than those of another row."""
    row = Indices()
    for i in range(TILE):
        row[i] = wp.max(edges[i], _jump(here[i], depth[i], other[i], other_depth[i]))
    return row


@wp.func
def _sides_row(here: Indices, depth: Row, left: int, depth_left: float, right: int, depth_right: float) -> Indices:
    """1 for each pixel of a row that shows another shape at another depth than the pixel to its left or right."""
    row = Indices()
    for i in range(TILE):
        before, behind = wp.max(i - 1, 0), wp.min(i + 1, TILE - 1)
        row[i] = wp.max(
            _jump(here[i], depth[i], here[before], depth[before]), _jump(here[i], depth[i], here[behind], depth[behind])
        )
    row[0] = wp.max(row[0], _jump(here[0], depth[0], left, depth_left))
    row[TILE - 1] = wp.max(row[TILE - 1], _jump(here[TILE - 1], depth[TILE - 1], right, depth_right))
    return row


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
def _smooth_row(
    intrinsics: CameraIntrinsics,
    worlds: Worlds,
    colors: wp.array3d[Indices],
    edges: Indices,
    here: Indices,
    above: Indices,
    below: Indices,
    w: int,
    y: int,
    column: int,
) -> Indices:
    """Colours of a row, in which pixels on edges are the mean of four samples."""
    sharp, smooth = colors[w, y, column] + Indices(0), colors[w, y, column] + Indices(0)
    color_above = colors[w, wp.max(y - 1, 0), column] + Indices(0)
    color_below = colors[w, wp.min(y + 1, intrinsics.size - 1), column] + Indices(0)
    members, xs, ys = Members(), Row(), Row()
    found = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
    for i in range(TILE):
        if edges[i] == 1:
            members[found] = i
            for k in range(SAMPLES):
                offset = _offset(k)
                xs[SAMPLES * found + k] = slope(intrinsics, column * TILE + i) + offset[0] / intrinsics.focal
                ys[SAMPLES * found + k] = -slope(intrinsics, y) + offset[1] / intrinsics.focal
            found += 1
        if found == GROUP or (found > 0 and i == TILE - 1):
            seen = _trace_seen(worlds, here, above, below, w, tile_of(intrinsics, y, column), xs, ys)
            for j in range(found):
                at = members[j]
                left, right = wp.max(at - 1, 0), wp.min(at + 1, TILE - 1)
                even, odd = int(0x20002), int(2)  # noqa: RUF046, UP018 - they vary; two rounds to the nearest
                for k in range(SAMPLES):
                    shape, color = seen[SAMPLES * j + k], sharp[at]
                    color = wp.where(shape == here[left], sharp[left], color)
                    color = wp.where(shape == here[right], sharp[right], color)
                    color = wp.where(shape == below[at], color_below[at], color)
                    color = wp.where(shape == above[at], color_above[at], color)
                    color = wp.where(shape == here[at], sharp[at], color)
                    even += color & 0xFF00FF
                    odd += (color >> 8) & 0xFF
                smooth[at] = ((even >> 2) & 0xFF00FF) | ((odd >> 2) << 8)
            found = 0
    return smooth


@wp.func
def _trace_seen(
    worlds: Worlds, here: Indices, above: Indices, below: Indices, w: int, tile: int, xs: Row, ys: Row
) -> Indices:
    """The nearest shape along each ray, of those that the row or one beside it shows."""
    depths, nearest = Row(FAR), Indices(-1)
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        seen = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            seen = wp.max(seen, wp.where(here[i] == s or above[i] == s or below[i] == s, 1, 0))
        if seen == 1:
            depths, nearest = meet_shape(worlds.shapes, w, s, depths, nearest, xs, ys)
    return nearest
