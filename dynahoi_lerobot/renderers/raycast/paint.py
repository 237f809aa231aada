"""Look along the rays and paint: a thread takes one row of one tile."""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.layout import FAR, TILE, Lens, Shape
from dynahoi_lerobot.renderers.raycast.rows import Indices, Row, enter_row, light_row, paper_row

TIE = wp.constant(1.0e-6)
"""Of surfaces this close together, relatively, the later geom shows, as in MuJoCo."""

SOLID = wp.constant(1.0)
"""Opacity of what nothing shows through."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class Lamps:
    """What lights every world alike: ambient light and the headlight."""

    ambient: wp.vec3
    headlight: wp.vec3


@wp.kernel
def paint(
    first_row: int,
    lens: Lens,
    lamps: Lamps,
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    light_diffuse: wp.array2d[wp.vec3],
    light_specular: wp.array2d[wp.vec3],
    textures: wp.array3d[float],
    pictures: wp.array3d[wp.vec3ub],
):
    """Paint one row of one tile; (row of all pictures, counted through, column of tiles)."""
    row, column = wp.tid()
    w, y = (first_row + row) // lens.size, (first_row + row) % lens.size
    depths, seen = _look(lens, shapes, lists, counts, w, y, column, 0.0)
    daylight, shine = light_diffuse[w, 0], light_specular[w, 0]
    red, green, blue = _shade(lens, lamps, shapes, lists, counts, daylight, shine, textures, depths, seen, w, y, column)
    clear = Row(0.0)
    clearest = float(0.0)  # noqa: UP018 - warp's way to say that it varies
    for i in range(TILE):
        if seen[i] >= 0:
            clear[i] = 1.0 - shapes[w, seen[i]].alpha
        clearest = wp.max(clearest, clear[i])
    if clearest > 0.0:
        depths, seen = _look(lens, shapes, lists, counts, w, y, column, SOLID)
        r, g, b = _shade(lens, lamps, shapes, lists, counts, daylight, shine, textures, depths, seen, w, y, column)
        for i in range(TILE):
            red[i] = wp.lerp(red[i], r[i], clear[i])
            green[i] = wp.lerp(green[i], g[i], clear[i])
            blue[i] = wp.lerp(blue[i], b[i], clear[i])
    for i in range(wp.min(TILE, lens.size - column * TILE)):
        pictures[w, y, column * TILE + i] = wp.vec3ub(_level(red[i]), _level(green[i]), _level(blue[i]))


@wp.func
def _shade(
    lens: Lens,
    lamps: Lamps,
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    daylight: wp.vec3,
    shine: wp.vec3,
    textures: wp.array3d[float],
    depths: Row,
    seen: Indices,
    w: int,
    y: int,
    column: int,
) -> tuple[Row, Row, Row]:
    """Return red, green and blue, 0 to 1, of what a row of a tile sees."""
    red = Row(0.0)
    green = Row(0.0)
    blue = Row(0.0)
    ray = _first_ray(lens, y, column)
    for k in range(counts[w, _tile(lens, y, column)]):
        s = lists[w, _tile(lens, y, column), k]
        pixels = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            pixels += wp.where(seen[i] == s, 1, 0)
        if pixels > 0:
            shape = shapes[w, s]
            first = shape.from_camera * ray
            step = shape.from_camera * wp.vec3(1.0 / lens.focal, 0.0, 0.0)
            sun, front, highlight = light_row(shape, depths, first, step, shine[0] > 0.0)
            paper = Row(1.0)
            if shape.texture >= 0:
                paper = paper_row(shape, depths, first, step, textures)
            for i in range(TILE):
                light = lamps.ambient + daylight * sun[i] + lamps.headlight * front[i]
                color = wp.cw_mul(shape.tint, light) * paper[i] + shine * (shape.gloss * highlight[i])
                red[i] = wp.where(seen[i] == s, color[0], red[i])
                green[i] = wp.where(seen[i] == s, color[1], green[i])
                blue[i] = wp.where(seen[i] == s, color[2], blue[i])
    return red, green, blue


@wp.kernel
def survey(
    lens: Lens,
    shown: wp.array[int],
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    labels: wp.array3d[int],
    distances: wp.array3d[float],
):
    """Write the geoms that one row of one tile sees, -1 for none, and their depth; (world, row, column of tiles)."""
    w, y, column = wp.tid()
    depths, seen = _look(lens, shapes, lists, counts, w, y, column, 0.0)
    for i in range(wp.min(TILE, lens.size - column * TILE)):
        labels[w, y, column * TILE + i] = -1
        distances[w, y, column * TILE + i] = 0.0
        if seen[i] >= 0:
            labels[w, y, column * TILE + i] = shown[seen[i]]
            distances[w, y, column * TILE + i] = depths[i]


@wp.func
def _look(
    lens: Lens,
    shapes: wp.array2d[Shape],
    lists: wp.array3d[int],
    counts: wp.array2d[int],
    w: int,
    y: int,
    column: int,
    least_alpha: float,
) -> tuple[Row, Indices]:
    """Find depth [m] and number of the shapes of some opacity, -1 for none, that one row of one tile sees."""
    tile = _tile(lens, y, column)
    depths = Row(FAR)
    seen = Indices(-1)
    ray = _first_ray(lens, y, column)
    for k in range(counts[w, tile]):
        s = lists[w, tile, k]
        first = shapes[w, s].from_camera * ray
        step = shapes[w, s].from_camera * wp.vec3(1.0 / lens.focal, 0.0, 0.0)
        row = enter_row(shapes[w, s].kind, shapes[w, s].size, shapes[w, s].camera, first, step)
        if shapes[w, s].alpha < least_alpha:
            row = Row(-1.0)
        for i in range(TILE):
            shows = row[i] > 0.0 and row[i] <= depths[i] + TIE * wp.max(depths[i], 1.0)
            depths[i] = wp.where(shows, row[i], depths[i])
            seen[i] = wp.where(shows, s, seen[i])
    return depths, seen


@wp.func
def _first_ray(lens: Lens, y: int, column: int) -> wp.vec3:
    """Ray through the first pixel of a row, camera frame, of depth 1."""
    half = 0.5 * float(lens.size)
    x = float(column * TILE) + 0.5 - half
    return wp.vec3(x / lens.focal, (half - float(y) - 0.5) / lens.focal, -1.0)


@wp.func
def _tile(lens: Lens, y: int, column: int) -> int:
    return (y // TILE) * ((lens.size + TILE - 1) // TILE) + column


@wp.func
def _level(value: float) -> wp.uint8:
    return wp.uint8(int(wp.clamp(value, 0.0, 1.0) * 255.0))
