"""The rendering kernels: what each pixel shows, its colour, then edges; one thread does one pixel row of one tile."""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.lighting import Look, color_row
from dynahoi_lerobot.renderers.raycast.textures import Textures
from dynahoi_lerobot.renderers.raycast.tiling import TILE, CameraIntrinsics, Indices, Row
from dynahoi_lerobot.renderers.raycast.tracing import Worlds, trace_row

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.kernel
def trace(
    first_row: int,
    intrinsics: CameraIntrinsics,
    worlds: Worlds,
    visible: wp.array3d[Indices],
    depths: wp.array3d[Row],
):
    """Write index (-1 for none) and depth [m] of the shapes that one pixel row of one tile shows.

    Launched over (pixel rows, tile columns); the rows of all images are numbered consecutively from ``first_row``.
    """
    row, column = wp.tid()
    w, y = (first_row + row) // intrinsics.size, (first_row + row) % intrinsics.size
    tile = tile_of(intrinsics, y, column)
    distance, shape = trace_row(worlds, w, tile, intrinsics.slopes[column], ys_of(intrinsics, y), 0.0)
    visible[w, y, column] = shape
    depths[w, y, column] = distance


@wp.kernel
def render_color(
    first_row: int,
    intrinsics: CameraIntrinsics,
    look: Look,
    textures: Textures,
    worlds: Worlds,
    visible: wp.array3d[Indices],
    depths: wp.array3d[Row],
    colors: wp.array3d[Indices],
    images: wp.array3d[wp.uint32],
):
    """Write the colours of one pixel row of one tile, from the middle of each pixel, as 0xBBGGRR.

    Launched as ``trace`` is, after it.
    """
    row, column = wp.tid()
    w, y = (first_row + row) // intrinsics.size, (first_row + row) % intrinsics.size
    tile = tile_of(intrinsics, y, column)
    xs, ys = intrinsics.slopes[column] * 1.0, ys_of(intrinsics, y)
    red, green, blue = color_row(worlds, look, textures, w, tile, depths[w, y, column], visible[w, y, column], xs, ys)
    packed = Indices()
    for i in range(TILE):
        packed[i] = _level(red[i]) + (_level(green[i]) << 8) + (_level(blue[i]) << 16)
    colors[w, y, column] = packed
    write_row(images, w, y, column, packed)


@wp.kernel
def render_ids_and_depth(
    intrinsics: CameraIntrinsics,
    shown: wp.array[int],
    worlds: Worlds,
    labels: wp.array3d[int],
    distances: wp.array3d[float],
):
    """Write geom ids (-1 for none) and depth [m] (0 for none) of one pixel row of one tile.

    Launched over (worlds, pixel rows, tile columns).
    """
    w, y, column = wp.tid()
    tile = tile_of(intrinsics, y, column)
    depths, visible = trace_row(worlds, w, tile, intrinsics.slopes[column], ys_of(intrinsics, y), 0.0)
    for i in range(wp.min(TILE, intrinsics.size - column * TILE)):
        labels[w, y, column * TILE + i] = -1
        distances[w, y, column * TILE + i] = 0.0
        if visible[i] >= 0:
            labels[w, y, column * TILE + i] = shown[visible[i]]
            distances[w, y, column * TILE + i] = depths[i]


@wp.func
def write_row(images: wp.array3d[wp.uint32], w: int, y: int, column: int, colors: Indices):
    """Write one pixel row of one tile of the images, whose bytes are taken four at a time."""
    for group in range(TILE // 4):
        a, b = wp.uint32(colors[4 * group]), wp.uint32(colors[4 * group + 1])
        c, d = wp.uint32(colors[4 * group + 2]), wp.uint32(colors[4 * group + 3])
        word = 3 * (TILE // 4 * column + group)
        images[w, y, word] = a | (b << wp.uint32(24))
        images[w, y, word + 1] = (b >> wp.uint32(8)) | (c << wp.uint32(16))
        images[w, y, word + 2] = (c >> wp.uint32(16)) | (d << wp.uint32(8))


@wp.func
def ys_of(intrinsics: CameraIntrinsics, y: int) -> Row:
    """Return the slopes upwards of the rays through pixel row ``y``."""
    return Row(-slope(intrinsics, y))


@wp.func
def slope(intrinsics: CameraIntrinsics, pixel: int) -> float:
    """Return the slope, to the right or downwards, of the ray through the middle of a pixel."""
    return (float(pixel) + 0.5 - 0.5 * float(intrinsics.size)) / intrinsics.focal


@wp.func
def tile_of(intrinsics: CameraIntrinsics, y: int, column: int) -> int:
    """Return the number of the tile in a pixel row and a tile column."""
    return (y // TILE) * ((intrinsics.size + TILE - 1) // TILE) + column


@wp.func
def _level(value: float) -> int:
    return int(wp.clamp(value, 0.0, 1.0) * 255.0)
