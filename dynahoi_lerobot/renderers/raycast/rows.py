"""One shape and sixteen rays from the camera: depth, lighting, texture and shadow at the points
that they meet.

The loops over the rays hold no branches and stay loops, so that compilers turn them into vector
instructions; that is most of the speed on a CPU. Shapes are passed by number, as the processor
waits for a copy that it has just stored in small parts and loads as a whole. Ray i has the
direction ``(xs[i], ys[i], -1)`` in the camera's frame.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

import warp as wp

from dynahoi_lerobot.renderers.raycast import shapes as solids
from dynahoi_lerobot.renderers.raycast.shapes import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE
from dynahoi_lerobot.renderers.raycast.textures import Textures, level_of, texel
from dynahoi_lerobot.renderers.raycast.tiling import (
    FAR,
    SPREAD,
    TILE,
    Indices,
    Row,
    Shape,
    Worlds,
    may_shade,
    ray_of,
)
from dynahoi_lerobot.scene.model import SHININESS

HIGHLIGHT_EXPONENT = wp.constant(128.0 * SHININESS)
"""Blinn exponent, computed as OpenGL does."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class Look:
    """How all worlds are drawn.

    Attributes:
        soft: 1 for shadows, soft light and smooth edges; 0 for what MuJoCo's other renderers draw.
        ambient: RGB of the light that reaches every surface, 0 to 1; what the ground reflects if
            ``soft``.
        fill: RGB of the light from the camera, or from the whole sky if ``soft``.
        fill_wrap: how far beyond a right angle that light reaches, as a cosine; ``sun_wrap``:
            likewise the sun's.
        pixel_rad: angle between the rays of neighboring pixels [rad].
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


def _entering(enter: wp.Function) -> wp.Function:
    """Return a function that intersects one type of shape with every ray of a row."""

    @wp.func
    def entered(shapes: wp.array2d[Shape], w: int, s: int, xs: Row, ys: Row) -> Row:
        size = shapes[w, s].size
        o = shapes[w, s].camera
        from_camera = shapes[w, s].from_camera
        row = Row()
        for i in range(TILE):
            row[i] = enter(size, o, ray_of(from_camera, xs[i], ys[i]))
        return row

    return entered


def _surface(normal: wp.Function, uv: wp.Function) -> wp.Function:
    """Return a function that computes light, highlights and texture at the points of a row."""

    @wp.func
    def surface(
        worlds: Worlds,
        look: Look,
        textures: Textures,
        w: int,
        s: int,
        middle: int,
        depths: Row,
        xs: Row,
        ys: Row,
    ) -> tuple[Row, Row, Row, Row]:
        diffuse = Row()
        filled = Row()
        highlight = Row(0.0)
        brightness = Row(1.0)
        shapes = worlds.shapes
        size = shapes[w, s].size
        o = shapes[w, s].camera
        from_camera = shapes[w, s].from_camera
        light = shapes[w, s].to_light
        fill = wp.where(look.soft == 1, shapes[w, s].up, from_camera * wp.vec3(0.0, 0.0, 1.0))
        for i in range(TILE):
            n = normal(size, o + depths[i] * ray_of(from_camera, xs[i], ys[i]))
            diffuse[i] = wp.dot(n, light)
            filled[i] = wp.dot(n, fill)
        if worlds.specular[w, 0][0] > 0.0:
            for i in range(TILE):
                ray = ray_of(from_camera, xs[i], ys[i])
                n = normal(size, o + depths[i] * ray)
                halfway = wp.normalize(light - wp.normalize(ray))
                facing = wp.where(wp.dot(n, light) > 0.0, wp.dot(n, halfway), 0.0)
                highlight[i] = wp.pow(wp.max(facing, 0.0), HIGHLIGHT_EXPONENT)
        if shapes[w, s].texture >= 0:
            ray = ray_of(from_camera, xs[middle], ys[middle])
            n = normal(size, o + depths[middle] * ray)
            facing = wp.abs(wp.dot(n, ray)) / wp.length(ray)
            level = level_of(
                textures, shapes[w, s].repeats_per_m * depths[middle] * look.pixel_rad, facing
            )
            start = shapes[w, s].texture * textures.texels_each + textures.starts[level]
            side = textures.sides[level]
            repeat = shapes[w, s].repeat
            for i in range(TILE):
                at = wp.cw_mul(uv(size, o + depths[i] * ray_of(from_camera, xs[i], ys[i])), repeat)
                u = at[0] - wp.floor(at[0])
                v = at[1] - wp.floor(at[1])
                brightness[i] = texel(textures.texels, start, side, textures.filtered, u, v)
        return diffuse, filled, highlight, brightness

    return surface


def _shading(shadow: wp.Function) -> wp.Function:
    """Return a function that computes what one type of shape takes from the points of a row."""

    @wp.func
    def shaded(shapes: wp.array2d[Shape], w: int, s: int, depths: Row, xs: Row, ys: Row) -> Row:
        size = shapes[w, s].size
        o = shapes[w, s].camera
        from_camera = shapes[w, s].from_camera
        light = shapes[w, s].to_light
        row = Row()
        for i in range(TILE):
            point = o + depths[i] * ray_of(from_camera, xs[i], ys[i])
            row[i] = shadow(size, SPREAD, point, light)
        return row

    return shaded


def _of_a_row(solid: str) -> tuple[wp.Function, wp.Function]:
    """Return the functions of a row for a type of shape: depths, and what its surface looks
    like.
    """
    enter, normal, uv = (getattr(solids, f"{what}_{solid}") for what in ("enter", "normal", "uv"))
    return _entering(enter), _surface(normal, uv)


_enter_plane, _surface_plane = _of_a_row("plane")
_enter_sphere, _surface_sphere = _of_a_row("sphere")
_enter_capsule, _surface_capsule = _of_a_row("capsule")
_enter_cylinder, _surface_cylinder = _of_a_row("cylinder")
_enter_ellipsoid, _surface_ellipsoid = _of_a_row("ellipsoid")
_enter_box, _surface_box = _of_a_row("box")
_shade_sphere, _shade_capsule, _shade_cylinder, _shade_ellipsoid, _shade_box = (
    _shading(getattr(solids, f"shadow_{solid}"))
    for solid in ("sphere", "capsule", "cylinder", "ellipsoid", "box")
)


@wp.func
def _enter_row(shapes: wp.array2d[Shape], w: int, s: int, xs: Row, ys: Row) -> Row:
    """The depths [m] at which a row of rays from the camera enters a shape, negative where it does
    not.
    """
    kind = shapes[w, s].geom_type
    if kind == PLANE:
        return _enter_plane(shapes, w, s, xs, ys)
    if kind == CAPSULE:
        return _enter_capsule(shapes, w, s, xs, ys)
    if kind == BOX:
        return _enter_box(shapes, w, s, xs, ys)
    if kind == CYLINDER:
        return _enter_cylinder(shapes, w, s, xs, ys)
    if kind == ELLIPSOID:
        return _enter_ellipsoid(shapes, w, s, xs, ys)
    return _enter_sphere(shapes, w, s, xs, ys)


@wp.func
def surface_row(
    worlds: Worlds,
    look: Look,
    textures: Textures,
    w: int,
    s: int,
    middle: int,
    depths: Row,
    xs: Row,
    ys: Row,
) -> tuple[Row, Row, Row, Row]:
    """Return the color of the points of a row on a shape.

    Args:
        worlds, look, textures: of the scene; ``w``, ``s``: the world and the shape.
        middle: one of the rays that show the shape; it decides how sharp the texture is.
        depths: of the points [m]; ``xs``, ``ys``: slopes of their rays.

    Returns:
        Cosines between normal and sunlight and between normal and the other light, highlights
        (Blinn, 1977), and the brightness of the texture, 0 to 1.
    """
    kind = worlds.shapes[w, s].geom_type
    if kind == PLANE:
        return _surface_plane(worlds, look, textures, w, s, middle, depths, xs, ys)
    if kind == CAPSULE:
        return _surface_capsule(worlds, look, textures, w, s, middle, depths, xs, ys)
    if kind == BOX:
        return _surface_box(worlds, look, textures, w, s, middle, depths, xs, ys)
    if kind == CYLINDER:
        return _surface_cylinder(worlds, look, textures, w, s, middle, depths, xs, ys)
    if kind == ELLIPSOID:
        return _surface_ellipsoid(worlds, look, textures, w, s, middle, depths, xs, ys)
    return _surface_sphere(worlds, look, textures, w, s, middle, depths, xs, ys)


TIE = wp.constant(1.0e-6)
"""Relative depth difference below which the later of two geoms is visible, as in MuJoCo."""
MISSED = wp.constant(1.0e30)
"""Depth of a ray that meets nothing: beyond all others."""


@wp.func
def trace_row(
    worlds: Worlds, w: int, tile: int, xs: Row, ys: Row, least_alpha: float
) -> tuple[Row, Indices]:
    """Return depth [m] and index of the nearest shape (-1 for none) whose alpha is at least
    ``least_alpha``.
    """
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
    """Return depths and indices, replaced by shape ``s`` where it is nearer."""
    row = _enter_row(shapes, w, s, xs, ys)
    nearest = Row()
    seen = Indices()
    for i in range(TILE):
        limit = depths[i] + TIE * wp.max(depths[i], 1.0)
        ahead = wp.where(row[i] > 0.0, row[i], MISSED)
        nearest[i] = wp.where(ahead <= limit, row[i], depths[i])
        seen[i] = wp.where(ahead <= limit, s, visible[i])
    return nearest, seen


@wp.func
def _shade_row(shapes: wp.array2d[Shape], w: int, s: int, depths: Row, xs: Row, ys: Row) -> Row:
    """The share of the light that a shape takes from the points of a row."""
    kind = shapes[w, s].geom_type
    if kind == CAPSULE:
        return _shade_capsule(shapes, w, s, depths, xs, ys)
    if kind == BOX:
        return _shade_box(shapes, w, s, depths, xs, ys)
    if kind == CYLINDER:
        return _shade_cylinder(shapes, w, s, depths, xs, ys)
    if kind == ELLIPSOID:
        return _shade_ellipsoid(shapes, w, s, depths, xs, ys)
    return _shade_sphere(shapes, w, s, depths, xs, ys)


@wp.func
def sunlight_row(
    worlds: Worlds, w: int, tile: int, depths: Row, visible: Indices, xs: Row, ys: Row
) -> Row:
    """Return the share of the light, 0 to 1, that reaches the points of a row; no shape shades
    itself.
    """
    row = Row(1.0)
    if worlds.caster_counts[w, tile] == 0:
        return row
    low, high = _row_bounds(
        worlds.light_camera[w], worlds.light_from_camera[w], depths, visible, xs, ys
    )
    for k in range(worlds.caster_counts[w, tile]):
        s = worlds.casters[w, tile, k]
        if may_shade(worlds.shapes[w, s].low, worlds.shapes[w, s].high, low, high):
            taken = _shade_row(worlds.shapes, w, s, depths, xs, ys)
            alpha = worlds.shapes[w, s].alpha
            for i in range(TILE):
                left = wp.where(visible[i] == s, 1.0, 1.0 - alpha * taken[i])
                row[i] = wp.min(row[i], left)
    return row


@wp.func
def _row_bounds(
    camera: wp.vec3, from_camera: wp.mat33, depths: Row, visible: Indices, xs: Row, ys: Row
) -> tuple[wp.vec3, wp.vec3]:
    """Lower and upper corner [m], light frame, of a box around the points of a row, whose rays lie
    in a plane.
    """
    least = Indices()
    most = Indices()
    for i in range(TILE):
        least[i] = wp.cast(
            depths[i], wp.int32
        )  # bits of floats that are not negative are in the order of the floats
        most[i] = wp.where(visible[i] >= 0, least[i], 0)
    near = wp.cast(wp.min(least), wp.float32)
    far = wp.cast(wp.max(most), wp.float32)
    first = ray_of(from_camera, xs[0], ys[0])
    last = ray_of(from_camera, xs[TILE - 1], ys[TILE - 1])
    low = wp.min(wp.min(near * first, far * first), wp.min(near * last, far * last))
    high = wp.max(wp.max(near * first, far * first), wp.max(near * last, far * last))
    return camera + low, camera + high
