"""The color of a row of visible points: textures, sunlight with soft shadows, and light from all
around.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

import warp as wp

from dynahoi_lerobot.renderers.raycast.rows import (
    Look,
    meet_shape,
    sunlight_row,
    surface_row,
    trace_row,
)
from dynahoi_lerobot.renderers.raycast.textures import Textures
from dynahoi_lerobot.renderers.raycast.tiling import (
    FAR,
    TILE,
    CameraIntrinsics,
    Indices,
    Row,
    Worlds,
    ray_of,
    slope,
)

SOLID = wp.constant(1.0)
"""Alpha of an opaque shape."""
CORNER_DARKNESS = wp.constant(0.4)
CORNER_M = wp.constant(0.12)
"""Share of the light from all around that corners of the room take away, and the distance at which
it is half that."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.func
def color_row(
    worlds: Worlds,
    look: Look,
    textures: Textures,
    w: int,
    tile: int,
    depths: Row,
    visible: Indices,
    xs: Row,
    ys: Row,
) -> tuple[Row, Row, Row]:
    """Return red, green and blue of the visible points; behind a translucent shape the nearest
    opaque one is seen.
    """
    red, green, blue = _surface_row(worlds, look, textures, w, tile, depths, visible, xs, ys)
    transparency = Row(0.0)
    most_transparent = float(0.0)  # noqa: UP018 - warp's way to say that it varies
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        clear = 1.0 - worlds.shapes[w, s].alpha
        if clear > 0.0:
            for i in range(TILE):
                transparency[i] = wp.where(visible[i] == s, clear, transparency[i])
            most_transparent = wp.max(transparency)
    if most_transparent > 0.0:
        behind, solid = trace_row(worlds, w, tile, xs, ys, SOLID)
        r, g, b = _surface_row(worlds, look, textures, w, tile, behind, solid, xs, ys)
        for i in range(TILE):
            red[i] = wp.lerp(red[i], r[i], transparency[i])
            green[i] = wp.lerp(green[i], g[i], transparency[i])
            blue[i] = wp.lerp(blue[i], b[i], transparency[i])
    return red, green, blue


@wp.func
def _surface_row(
    worlds: Worlds,
    look: Look,
    textures: Textures,
    w: int,
    tile: int,
    depths: Row,
    visible: Indices,
    xs: Row,
    ys: Row,
) -> tuple[Row, Row, Row]:
    """Red, green and blue, 0 to 1, of the surfaces at the points of a row."""
    red = Row(0.0)
    green = Row(0.0)
    blue = Row(0.0)
    diffuse = worlds.diffuse[w, 0]
    specular = worlds.specular[w, 0]
    ambient = look.ambient
    sky = look.fill
    sky_wrap = look.fill_wrap
    sun_wrap = look.sun_wrap
    sun = Row(1.0)
    openness = Row(1.0)
    if look.soft == 1:
        sun = sunlight_row(worlds, w, tile, depths, visible, xs, ys)
        openness = _openness_row(worlds, look, w, depths, visible, xs, ys)
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        middle = int(-1)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            middle = wp.max(middle, wp.where(visible[i] == s, i, -1))
        if middle >= 0:
            cosine, filled, highlight, brightness = surface_row(
                worlds, look, textures, w, s, middle, depths, xs, ys
            )
            rgb = worlds.shapes[w, s].color_rgb
            shine = specular * worlds.shapes[w, s].specularity
            for i in range(TILE):
                direct = wp.max(cosine[i] + sun_wrap, 0.0) / (1.0 + sun_wrap) * sun[i]
                around = wp.max(filled[i] + sky_wrap, 0.0)
                light = (ambient + sky * around) * openness[i] + diffuse * direct
                color = wp.cw_mul(rgb, light) * brightness[i] + shine * (highlight[i] * sun[i])
                red[i] = wp.where(visible[i] == s, color[0], red[i])
                green[i] = wp.where(visible[i] == s, color[1], green[i])
                blue[i] = wp.where(visible[i] == s, color[2], blue[i])
    return red, green, blue


@wp.func
def _openness_row(
    worlds: Worlds, look: Look, w: int, depths: Row, visible: Indices, xs: Row, ys: Row
) -> Row:
    """Share of the light from all around that reaches each point: less near the floor, on the floor
    near walls.
    """
    row = Row()
    floor = worlds.shapes[w, look.floor]
    half = look.room_half_m
    number = look.floor
    for i in range(TILE):
        point = floor.camera + depths[i] * ray_of(floor.from_camera, xs[i], ys[i])
        from_walls = half - wp.max(wp.abs(point[0]), wp.abs(point[1]))
        clear = wp.max(wp.where(visible[i] == number, from_walls, point[2]), 0.0)
        row[i] = 1.0 - CORNER_DARKNESS * CORNER_M / (CORNER_M + clear)
    return row


@wp.kernel
def trace(first_row: int, intrinsics: CameraIntrinsics, worlds: Worlds):
    """Write index (-1 for none) and depth [m] of the shapes that one pixel row of one tile shows.

    Launched over (pixel rows, tile columns); the rows of all images are numbered consecutively from
    ``first_row``.
    """
    row, column = wp.tid()
    w = (first_row + row) // intrinsics.size
    y = (first_row + row) % intrinsics.size
    tile = _tile_of(intrinsics, y, column)
    distance, shape = trace_row(
        worlds, w, tile, _xs_of(intrinsics, column), _ys_of(intrinsics, y), 0.0
    )
    worlds.visible[w, y, column] = shape
    worlds.depths[w, y, column] = distance


@wp.kernel
def render_color(
    first_row: int, intrinsics: CameraIntrinsics, look: Look, textures: Textures, worlds: Worlds
):
    """Write the colors in the middle of the pixels of one row of one tile. Launched as ``trace``,
    after it.
    """
    row, column = wp.tid()
    w = (first_row + row) // intrinsics.size
    y = (first_row + row) % intrinsics.size
    tile = _tile_of(intrinsics, y, column)
    xs = _xs_of(intrinsics, column)
    ys = _ys_of(intrinsics, y)
    depths = worlds.depths[w, y, column]
    visible = worlds.visible[w, y, column]
    red, green, blue = color_row(worlds, look, textures, w, tile, depths, visible, xs, ys)
    packed = Indices()
    for i in range(TILE):
        packed[i] = _level(red[i]) + (_level(green[i]) << 8) + (_level(blue[i]) << 16)
    worlds.colors[w, y, column] = packed
    _write_row(worlds, w, y, column, packed)


@wp.func
def _write_row(worlds: Worlds, w: int, y: int, column: int, colors: Indices):
    """Write one pixel row of one tile of the images, whose last tiles may stick out."""
    for i in range(wp.min(TILE, worlds.images.shape[2] - column * TILE)):
        worlds.images[w, y, column * TILE + i, 0] = wp.uint8(colors[i])
        worlds.images[w, y, column * TILE + i, 1] = wp.uint8(colors[i] >> 8)
        worlds.images[w, y, column * TILE + i, 2] = wp.uint8(colors[i] >> 16)


@wp.func
def _xs_of(intrinsics: CameraIntrinsics, column: int) -> Row:
    """Slopes to the right of the rays through the pixels of a tile column."""
    xs = Row()
    for i in range(TILE):
        xs[i] = slope(intrinsics, float(column * TILE + i) + 0.5)
    return xs


@wp.func
def _ys_of(intrinsics: CameraIntrinsics, y: int) -> Row:
    """Slopes upwards of the rays through the middle of pixel row ``y``."""
    return Row(-slope(intrinsics, float(y) + 0.5))


@wp.func
def _tile_of(intrinsics: CameraIntrinsics, y: int, column: int) -> int:
    """The number of the tile in a pixel row and a tile column."""
    return (y // TILE) * intrinsics.tiles_across + column


@wp.func
def _level(value: float) -> int:
    return int(wp.clamp(value, 0.0, 1.0) * 255.0)


SAMPLES = wp.constant(4)
"""Samples of a pixel on an edge."""
GROUP = wp.constant(TILE // SAMPLES)
"""Pixels that are sampled together."""
Members = wp.types.vector(GROUP, wp.int32)
STEP = wp.constant(0.03)
"""Relative difference of depth between two shapes that makes an edge; where shapes touch, there is
little to smooth."""


@wp.kernel
def smooth_edges(first_row: int, intrinsics: CameraIntrinsics, worlds: Worlds):
    """Smooth the edges in one pixel row of one tile of the images. Launched as ``trace``, after
    ``render_color``.
    """
    row, column = wp.tid()
    w = (first_row + row) // intrinsics.size
    y = (first_row + row) % intrinsics.size
    y_above = wp.max(y - 1, 0)
    y_below = wp.min(y + 1, intrinsics.size - 1)
    before = wp.max(column - 1, 0)
    behind = wp.min(column + 1, intrinsics.tiles_across - 1)
    here = worlds.visible[w, y, column] + Indices(
        0
    )  # a sum is a copy; what is read of an array is read at every use
    above = worlds.visible[w, y_above, column] + Indices(0)
    below = worlds.visible[w, y_below, column] + Indices(0)
    left = worlds.visible[w, y, before][wp.where(column > 0, TILE - 1, 0)]
    right = worlds.visible[w, y, behind][wp.where(behind > column, 0, TILE - 1)]
    if _all_alike(here, above, below, left, right) == 0:
        depths = worlds.depths[w, y, column]
        depth_left = worlds.depths[w, y, before][TILE - 1]
        depth_right = worlds.depths[w, y, behind][0]
        near = _sides_row(here, depths, left, depth_left, right, depth_right)
        near = _jumps_row(near, here, depths, above, worlds.depths[w, y_above, column])
        edges = _jumps_row(near, here, depths, below, worlds.depths[w, y_below, column])
        if wp.max(edges) == 1:
            smooth = _smooth_row(intrinsics, worlds, edges, here, above, below, w, y, column)
            _write_row(worlds, w, y, column, smooth)


@wp.func
def _all_alike(here: Indices, above: Indices, below: Indices, left: int, right: int) -> int:
    """1 if all pixels of a row and all beside it show one shape."""
    shape = here[0]
    different = Indices()
    for i in range(TILE):
        different[i] = (here[i] ^ shape) | (above[i] ^ shape) | (below[i] ^ shape)
    others = (left ^ shape) | (right ^ shape)
    for i in range(TILE):
        others |= different[i]
    return wp.where(others == 0, 1, 0)


@wp.func
def _jumps_row(
    edges: Indices, here: Indices, depth: Row, other: Indices, other_depth: Row
) -> Indices:
    """Add the pixels whose shape and depth differ from the pixels of another row."""
    row = Indices()
    for i in range(TILE):
        row[i] = wp.max(edges[i], _jump(here[i], depth[i], other[i], other_depth[i]))
    return row


@wp.func
def _sides_row(
    here: Indices, depth: Row, left: int, depth_left: float, right: int, depth_right: float
) -> Indices:
    """1 for each pixel of a row that shows another shape at another depth than the pixel to its
    left or right.
    """
    row = Indices()
    for i in range(TILE):
        before = wp.max(i - 1, 0)
        behind = wp.min(i + 1, TILE - 1)
        row[i] = wp.max(
            _jump(here[i], depth[i], here[before], depth[before]),
            _jump(here[i], depth[i], here[behind], depth[behind]),
        )
    row[0] = wp.max(row[0], _jump(here[0], depth[0], left, depth_left))
    row[TILE - 1] = wp.max(
        row[TILE - 1], _jump(here[TILE - 1], depth[TILE - 1], right, depth_right)
    )
    return row


@wp.func
def _jump(shape: int, depth: float, other: int, other_depth: float) -> int:
    """1 if two pixels show shapes at different depths."""
    return wp.where(
        shape != other and wp.abs(depth - other_depth) > STEP * wp.min(depth, other_depth), 1, 0
    )


@wp.func
def _offset(sample: int) -> wp.vec2:
    """Where a sample lies from a pixel's middle [px]: a grid of 2 x 2, turned so that no two share
    row or column.
    """
    x = wp.where(sample < 2, 0.125, 0.375)
    y = wp.where(sample < 2, 0.375, -0.125)
    return wp.where(sample % 2 == 0, wp.vec2(x, y), wp.vec2(-x, -y))


@wp.func
def _smooth_row(
    intrinsics: CameraIntrinsics,
    worlds: Worlds,
    edges: Indices,
    here: Indices,
    above: Indices,
    below: Indices,
    w: int,
    y: int,
    column: int,
) -> Indices:
    """Colors of a row, in which pixels on edges are the mean of four samples."""
    sharp = worlds.colors[w, y, column] + Indices(0)
    smooth = worlds.colors[w, y, column] + Indices(0)
    color_above = worlds.colors[w, wp.max(y - 1, 0), column] + Indices(0)
    color_below = worlds.colors[w, wp.min(y + 1, intrinsics.size - 1), column] + Indices(0)
    members = Members()
    xs = Row()
    ys = Row()
    found = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
    for i in range(TILE):
        if edges[i] == 1:
            members[found] = i
            for k in range(SAMPLES):
                offset = _offset(k)
                xs[SAMPLES * found + k] = (
                    slope(intrinsics, float(column * TILE + i) + 0.5) + offset[0] / intrinsics.focal
                )
                ys[SAMPLES * found + k] = (
                    -slope(intrinsics, float(y) + 0.5) + offset[1] / intrinsics.focal
                )
            found += 1
        if found == GROUP or (found > 0 and i == TILE - 1):
            seen = _trace_seen(
                worlds, here, above, below, w, _tile_of(intrinsics, y, column), xs, ys
            )
            for j in range(found):
                at = members[j]
                left = wp.max(at - 1, 0)
                right = wp.min(at + 1, TILE - 1)
                even, odd = int(0x20002), int(2)  # noqa: RUF046, UP018 - they vary; two rounds to the nearest
                for k in range(SAMPLES):
                    shape = seen[SAMPLES * j + k]
                    color = sharp[at]
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
    worlds: Worlds,
    here: Indices,
    above: Indices,
    below: Indices,
    w: int,
    tile: int,
    xs: Row,
    ys: Row,
) -> Indices:
    """Return the nearest shape along each ray, among the shapes of the row and its neighbors."""
    depths = Row(FAR)
    nearest = Indices(-1)
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        seen = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            seen = wp.max(seen, wp.where(here[i] == s or above[i] == s or below[i] == s, 1, 0))
        if seen == 1:
            depths, nearest = meet_shape(worlds.shapes, w, s, depths, nearest, xs, ys)
    return nearest
