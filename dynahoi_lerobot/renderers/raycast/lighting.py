"""The colour of a row of visible points: textures, sunlight with soft shadows, and light from all around."""

# ruff: noqa: PLR0917 - warp functions take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.pixel_rows import highlight_row, light_row, ray_of, texture_row
from dynahoi_lerobot.renderers.raycast.shadows import sunlight_row
from dynahoi_lerobot.renderers.raycast.textures import Textures
from dynahoi_lerobot.renderers.raycast.tiling import TILE, Indices, Row
from dynahoi_lerobot.renderers.raycast.tracing import Worlds, trace_row

SOLID = wp.constant(1.0)
"""Alpha of an opaque shape."""
CORNER_DARKNESS = wp.constant(0.4)
CORNER_M = wp.constant(0.12)
"""Share of the light from all around that corners of the room take away, and the distance at which it is half that."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class Look:
    """How all worlds are drawn.

    Attributes:
        soft: 1 for shadows, soft light and smooth edges; 0 for what MuJoCo's other renderers draw.
        ambient: RGB of the light that reaches every surface, 0 to 1; what the ground reflects if ``soft``.
        fill: RGB of the light from the camera, or from the whole sky if ``soft``.
        fill_wrap: how far beyond a right angle that light reaches, as a cosine; ``sun_wrap``: likewise the sun's.
        pixel_rad: angle between the rays of neighbouring pixels [rad].
        floor: number of the shape that is the floor, whose frame is the world's.
        room_half_m: distance of the walls from the middle of the room [m].
    """

    soft: int
    ambient: wp.vec3
    fill: wp.vec3
    fill_wrap: float
    sun_wrap: float
    pixel_rad: float
    floor: int
    room_half_m: float


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
    """Return red, green and blue of the visible points; behind a translucent shape the nearest opaque one is seen."""
    red, green, blue = _surface_row(worlds, look, textures, w, tile, depths, visible, xs, ys)
    transparency = Row(0.0)
    most_transparent = float(0.0)  # noqa: UP018 - warp's way to say that it varies
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        clear = 1.0 - worlds.shapes[w, s].alpha
        if clear > 0.0:
            transparency = _mix_row(visible, s, clear, transparency)
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
def _mix_row(visible: Indices, s: int, value: float, others: Row) -> Row:
    """Return a value where shape ``s`` is visible, and that of the other row elsewhere."""
    row = Row()
    for i in range(TILE):
        row[i] = wp.where(visible[i] == s, value, others[i])
    return row


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
    red, green, blue = Row(0.0), Row(0.0), Row(0.0)
    diffuse, specular = worlds.diffuse[w, 0], worlds.specular[w, 0]
    ambient, sky, sky_wrap, sun_wrap = look.ambient, look.fill, look.fill_wrap, look.sun_wrap
    sun, openness = Row(1.0), Row(1.0)
    if look.soft == 1:
        sun = sunlight_row(worlds, w, tile, depths, visible, xs, ys)
        openness = _openness_row(worlds, look, w, depths, visible, xs, ys)
    for k in range(worlds.counts[w, tile]):
        s = worlds.lists[w, tile, k]
        middle = int(-1)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for i in range(TILE):
            middle = wp.max(middle, wp.where(visible[i] == s, i, -1))
        if middle >= 0:
            fill = worlds.shapes[w, s].up
            if look.soft == 0:
                fill = worlds.shapes[w, s].from_camera * wp.vec3(0.0, 0.0, 1.0)
            cosine, filled = light_row(worlds.shapes, w, s, fill, depths, xs, ys)
            highlight = Row(0.0)
            if specular[0] > 0.0:
                highlight = highlight_row(worlds.shapes, w, s, depths, xs, ys)
            brightness = Row(1.0)
            if worlds.shapes[w, s].texture >= 0:
                brightness = texture_row(worlds.shapes, w, s, textures, look.pixel_rad, middle, depths, xs, ys)
            rgb, shine = worlds.shapes[w, s].color_rgb, specular * worlds.shapes[w, s].specularity
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
def _openness_row(worlds: Worlds, look: Look, w: int, depths: Row, visible: Indices, xs: Row, ys: Row) -> Row:
    """Share of the light from all around that reaches each point: less near the floor, on the floor near walls."""
    row = Row()
    floor, half, number = worlds.shapes[w, look.floor], look.room_half_m, look.floor
    for i in range(TILE):
        point = floor.camera + depths[i] * ray_of(floor.from_camera, xs[i], ys[i])
        from_walls = half - wp.max(wp.abs(point[0]), wp.abs(point[1]))
        clear = wp.max(wp.where(visible[i] == number, from_walls, point[2]), 0.0)
        row[i] = 1.0 - CORNER_DARKNESS * CORNER_M / (CORNER_M + clear)
    return row
