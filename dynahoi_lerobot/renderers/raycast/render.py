"""The rendering kernels: colour, or geom ids and depth; one thread renders one pixel row of one tile."""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.pixel_rows import Indices, Row, enter_row, light_row, texture_row
from dynahoi_lerobot.renderers.raycast.tiling import FAR, TILE, CameraIntrinsics, Shape

TIE = wp.constant(1.0e-6)
"""Relative depth difference below which the later of two geoms is visible, as in MuJoCo."""

SOLID = wp.constant(1.0)
"""Alpha of an opaque shape."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class SharedLights:
    """Lights that all worlds share: RGB of the ambient light and of the headlight, 0 to 1."""

    ambient: wp.vec3
    headlight: wp.vec3


@wp.kernel
def render_color(
    first_row: int,
    intrinsics: CameraIntrinsics,
    shared_lights: SharedLights,
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    light_diffuse: wp.array2d[wp.vec3],
    light_specular: wp.array2d[wp.vec3],
    textures: wp.array3d[float],
    images: wp.array3d[wp.vec3ub],
):
    """Write the colour of one pixel row of one tile.

    Launched over (pixel rows, tile columns); the rows of all images are numbered consecutively from ``first_row``.
    Behind a translucent shape the nearest opaque one is blended in.
    """
    row, column = wp.tid()
    w, y = (first_row + row) // intrinsics.size, (first_row + row) % intrinsics.size
    depths, visible = _trace_row(intrinsics, shapes, lists, counts, w, y, column, 0.0)
    diffuse, specular = light_diffuse[w, 0], light_specular[w, 0]
    red, green, blue = _shade(
        intrinsics, shared_lights, shapes, lists, counts, diffuse, specular, textures, depths, visible, w, y, column
    )
    transparency = Row(0.0)
    most_transparent = float(0.0)  # noqa: UP018 - warp's way to say that it varies
    for i in range(TILE):
        if visible[i] >= 0:
            transparency[i] = 1.0 - shapes[w, visible[i]].alpha
        most_transparent = wp.max(most_transparent, transparency[i])
    if most_transparent > 0.0:
        depths, visible = _trace_row(intrinsics, shapes, lists, counts, w, y, column, SOLID)
        r, g, b = _shade(
            intrinsics, shared_lights, shapes, lists, counts, diffuse, specular, textures, depths, visible, w, y, column
        )
        for i in range(TILE):
            red[i] = wp.lerp(red[i], r[i], transparency[i])
            green[i] = wp.lerp(green[i], g[i], transparency[i])
            blue[i] = wp.lerp(blue[i], b[i], transparency[i])
    for i in range(wp.min(TILE, intrinsics.size - column * TILE)):
        images[w, y, column * TILE + i] = wp.vec3ub(_level(red[i]), _level(green[i]), _level(blue[i]))


@wp.func
def _shade(
    intrinsics: CameraIntrinsics,
    shared_lights: SharedLights,
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    diffuse: wp.vec3,
    specular: wp.vec3,
    textures: wp.array3d[float],
    depths: Row,
    visible: Indices,
    w: int,
    y: int,
    column: int,
) -> tuple[Row, Row, Row]:
    """Return red, green and blue, 0 to 1, of the visible points of one pixel row."""
    red = Row(0.0)
    green = Row(0.0)
    blue = Row(0.0)
    ray = _first_ray(intrinsics, y, column)
    for k in range(counts[w, _tile(intrinsics, y, column)]):
        s = lists[w, _tile(intrinsics, y, column), k]
        pixels = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            pixels += wp.where(visible[i] == s, 1, 0)
        if pixels > 0:
            shape = shapes[w, s]
            first = shape.from_camera * ray
            step = shape.from_camera * wp.vec3(1.0 / intrinsics.focal, 0.0, 0.0)
            cosine, headlight, highlight = light_row(shape, depths, first, step, specular[0] > 0.0)
            brightness = Row(1.0)
            if shape.texture >= 0:
                brightness = texture_row(shape, depths, first, step, textures)
            for i in range(TILE):
                light = shared_lights.ambient + diffuse * cosine[i] + shared_lights.headlight * headlight[i]
                color = wp.cw_mul(shape.color_rgb, light) * brightness[i] + specular * (
                    shape.specularity * highlight[i]
                )
                red[i] = wp.where(visible[i] == s, color[0], red[i])
                green[i] = wp.where(visible[i] == s, color[1], green[i])
                blue[i] = wp.where(visible[i] == s, color[2], blue[i])
    return red, green, blue


@wp.kernel
def render_ids_and_depth(
    intrinsics: CameraIntrinsics,
    shown: wp.array[int],
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    labels: wp.array3d[int],
    distances: wp.array3d[float],
):
    """Write geom ids (-1 for none) and depth [m] (0 for none) of one pixel row of one tile.

    Launched over (worlds, pixel rows, tile columns).
    """
    w, y, column = wp.tid()
    depths, visible = _trace_row(intrinsics, shapes, lists, counts, w, y, column, 0.0)
    for i in range(wp.min(TILE, intrinsics.size - column * TILE)):
        labels[w, y, column * TILE + i] = -1
        distances[w, y, column * TILE + i] = 0.0
        if visible[i] >= 0:
            labels[w, y, column * TILE + i] = shown[visible[i]]
            distances[w, y, column * TILE + i] = depths[i]


@wp.func
def _trace_row(
    intrinsics: CameraIntrinsics,
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    w: int,
    y: int,
    column: int,
    least_alpha: float,
) -> tuple[Row, Indices]:
    """Return depth [m] and index of the nearest shape (-1 for none) whose alpha is at least ``least_alpha``."""
    tile = _tile(intrinsics, y, column)
    depths = Row(FAR)
    visible = Indices(-1)
    ray = _first_ray(intrinsics, y, column)
    for k in range(counts[w, tile]):
        s = lists[w, tile, k]
        first = shapes[w, s].from_camera * ray
        step = shapes[w, s].from_camera * wp.vec3(1.0 / intrinsics.focal, 0.0, 0.0)
        row = enter_row(shapes[w, s].geom_type, shapes[w, s].size, shapes[w, s].camera, first, step)
        if shapes[w, s].alpha < least_alpha:
            row = Row(-1.0)
        for i in range(TILE):
            shows = row[i] > 0.0 and row[i] <= depths[i] + TIE * wp.max(depths[i], 1.0)
            depths[i] = wp.where(shows, row[i], depths[i])
            visible[i] = wp.where(shows, s, visible[i])
    return depths, visible


@wp.func
def _first_ray(intrinsics: CameraIntrinsics, y: int, column: int) -> wp.vec3:
    """Ray of depth 1 through the first pixel of a row of the tile, camera frame."""
    half = 0.5 * float(intrinsics.size)
    x = float(column * TILE) + 0.5 - half
    return wp.vec3(x / intrinsics.focal, (half - float(y) - 0.5) / intrinsics.focal, -1.0)


@wp.func
def _tile(intrinsics: CameraIntrinsics, y: int, column: int) -> int:
    return (y // TILE) * ((intrinsics.size + TILE - 1) // TILE) + column


@wp.func
def _level(value: float) -> wp.uint8:
    return wp.uint8(int(wp.clamp(value, 0.0, 1.0) * 255.0))
