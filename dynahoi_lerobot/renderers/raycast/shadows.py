"""Soft shadows: how much of the light a shape takes from a point.

The light is directional and seen as a small disc, so a shadow's edge widens with the distance from what casts it. The
share follows from how far outside a shape's outline, as the light sees it, the ray to the light passes: on the outline
half of the light is taken, and the penumbra is as wide on either side of it. ``spread`` is the light's angular radius
[rad]: half of the penumbra's width, per distance from what casts the shadow.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

import warp as wp

from dynahoi_lerobot.renderers.raycast.shapes import BOX, CAPSULE, CYLINDER, ELLIPSOID, slab_exit
from dynahoi_lerobot.renderers.raycast.tiling import SPREAD, TILE, Indices, Row, Shape, Worlds, may_shade, ray_of

TINY = wp.constant(1.0e-6)
FLAT = wp.constant(1.0e-4)
"""Least size [m] of an outline's round end, and least sine between a ray and the sides it may pass."""
BESIDE_ALL = wp.constant(1.0e3)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.func
def shadow_sphere(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share of the light, 0 to 1, that a sphere takes from point ``o``; ``d`` is the way to the light."""
    along = wp.max(-wp.dot(o, d), 0.0)
    return _covered(size[0], wp.length(o + along * d), spread * along)


@wp.func
def shadow_ellipsoid(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that an ellipsoid takes: in the space in which it is a sphere."""
    point, way = wp.cw_div(o, size), wp.cw_div(d, size)
    along = wp.max(-wp.dot(point, way) / wp.dot(way, way), 0.0)
    return _covered(1.0, wp.length(point + along * way), 3.0 * spread * along / (size[0] + size[1] + size[2]))


@wp.func
def shadow_capsule(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a capsule takes: from the nearest approach of ray and axis."""
    across = wp.max(d[0] * d[0] + d[1] * d[1], TINY)
    z = wp.clamp(o[2] - d[2] * (o[0] * d[0] + o[1] * d[1]) / across, -size[1], size[1])
    from_axis = wp.vec3(o[0], o[1], o[2] - z)
    along = wp.max(-wp.dot(from_axis, d), 0.0)
    return _covered(size[0], wp.length(from_axis + along * d), spread * along)


@wp.func
def shadow_cylinder(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a cylinder takes: its outline is a rectangle with an ellipse at either end."""
    a, b = wp.max(d[0] * d[0] + d[1] * d[1], TINY), o[0] * d[0] + o[1] * d[1]
    inside = wp.max(b * b - a * (o[0] * o[0] + o[1] * o[1] - size[0] * size[0]), 0.0)
    end = wp.min((wp.sqrt(inside) - b) / a, slab_exit(o[2], d[2], size[1]))
    aslant, radius, flat = wp.sqrt(a), size[0], wp.max(size[0] * wp.abs(d[2]), FLAT)
    across = wp.where(a > TINY, wp.vec3(d[1] / aslant, -d[0] / aslant, 0.0), wp.vec3(1.0, 0.0, 0.0))
    x, y = wp.abs(wp.dot(o, across)), wp.abs(wp.dot(o, wp.cross(across, d)))
    beyond = wp.max(y - size[1] * aslant, 0.0)
    slope = wp.vec2(x / (radius * radius), beyond / (flat * flat))
    scale = wp.sqrt(x * slope[0] + beyond * slope[1])
    round = wp.where(beyond > 0.0, scale * (scale - 1.0) / wp.max(wp.length(slope), TINY), -radius)
    outside = wp.max(wp.max(x - radius, y - size[1] * aslant - flat), round)
    return _straight(outside, spread, end)


@wp.func
def shadow_box(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a box takes: its outline is a hexagon of three pairs of parallel sides."""
    end = wp.min(slab_exit(o[0], d[0], size[0]), wp.min(slab_exit(o[1], d[1], size[1]), slab_exit(o[2], d[2], size[2])))
    x = _beside(o[1] * d[2] - o[2] * d[1], size[1] * wp.abs(d[2]) + size[2] * wp.abs(d[1]), d[1], d[2])
    y = _beside(o[2] * d[0] - o[0] * d[2], size[2] * wp.abs(d[0]) + size[0] * wp.abs(d[2]), d[2], d[0])
    z = _beside(o[0] * d[1] - o[1] * d[0], size[0] * wp.abs(d[1]) + size[1] * wp.abs(d[0]), d[0], d[1])
    return _straight(wp.max(x, wp.max(y, z)), spread, end)


@wp.func
def _beside(along: float, half: float, d1: float, d2: float) -> float:
    """Distance [m] at which a ray passes outside a pair of sides, if its direction has these parts across them."""
    aslant = wp.sqrt(d1 * d1 + d2 * d2)
    return wp.where(aslant < FLAT, -BESIDE_ALL, (wp.abs(along) - half) / wp.max(aslant, FLAT))


@wp.func
def _covered(radius: float, passing: float, wider: float) -> float:
    """Share of the light's disc behind a disc of this radius, which the ray passes at this distance from its centre."""
    return _half_shadow(passing - radius, wider) * wp.min(radius / (wider + TINY), 1.0)


@wp.func
def _straight(outside: float, spread: float, end: float) -> float:
    """Share of the light that a ray loses which passes this far outside an outline and leaves the shape at ``end``."""
    return wp.where(end > 0.0, _half_shadow(outside, spread * end), 0.0)


@wp.func
def _half_shadow(outside: float, wider: float) -> float:
    """Share of the light's disc behind an edge that a ray passes this far outside [m]; half of it on the edge."""
    share = wp.clamp(0.5 - outside / (2.0 * wider + TINY), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _shading(shadow: wp.Function) -> wp.Function:
    """Return a function that computes what one type of shape takes from the points of a row."""

    @wp.func
    def shaded(size: wp.vec3, o: wp.vec3, from_camera: wp.mat33, light: wp.vec3, depths: Row, xs: Row, ys: Row) -> Row:
        row = Row()
        for i in range(TILE):
            point = o + depths[i] * ray_of(from_camera, xs[i], ys[i])
            row[i] = shadow(size, SPREAD, point, light)
        return row

    return shaded


_shade_sphere, _shade_capsule, _shade_box = _shading(shadow_sphere), _shading(shadow_capsule), _shading(shadow_box)
_shade_cylinder, _shade_ellipsoid = _shading(shadow_cylinder), _shading(shadow_ellipsoid)


@wp.func
def _shade(shapes: wp.array2d[Shape], w: int, s: int, depths: Row, xs: Row, ys: Row) -> Row:
    geom_type, light = shapes[w, s].geom_type, shapes[w, s].to_light
    size, camera, from_camera = shapes[w, s].size, shapes[w, s].camera, shapes[w, s].from_camera
    if geom_type == CAPSULE:
        return _shade_capsule(size, camera, from_camera, light, depths, xs, ys)
    if geom_type == BOX:
        return _shade_box(size, camera, from_camera, light, depths, xs, ys)
    if geom_type == CYLINDER:
        return _shade_cylinder(size, camera, from_camera, light, depths, xs, ys)
    if geom_type == ELLIPSOID:
        return _shade_ellipsoid(size, camera, from_camera, light, depths, xs, ys)
    return _shade_sphere(size, camera, from_camera, light, depths, xs, ys)


@wp.func
def sunlight_row(worlds: Worlds, w: int, tile: int, depths: Row, visible: Indices, xs: Row, ys: Row) -> Row:
    """Return the share of the light, 0 to 1, that reaches the points of a row; no shape shades itself."""
    row = Row(1.0)
    if worlds.caster_counts[w, tile] == 0:
        return row
    low, high = _row_bounds(worlds.light_camera[w], worlds.light_from_camera[w], depths, visible, xs, ys)
    for k in range(worlds.caster_counts[w, tile]):
        s = worlds.casters[w, tile, k]
        if may_shade(worlds.shapes[w, s].low, worlds.shapes[w, s].high, low, high):
            taken = _shade(worlds.shapes, w, s, depths, xs, ys)
            alpha = worlds.shapes[w, s].alpha
            for i in range(TILE):
                left = wp.where(visible[i] == s, 1.0, 1.0 - alpha * taken[i])
                row[i] = wp.min(row[i], left)
    return row


@wp.func
def _row_bounds(
    camera: wp.vec3, from_camera: wp.mat33, depths: Row, visible: Indices, xs: Row, ys: Row
) -> tuple[wp.vec3, wp.vec3]:
    """Lower and upper corner [m], light frame, of a box around the points of a row, whose rays lie in a plane."""
    least, most = Indices(), Indices()
    for i in range(TILE):
        least[i] = wp.cast(depths[i], wp.int32)  # bits of floats that are not negative are in the order of the floats
        most[i] = wp.where(visible[i] >= 0, least[i], 0)
    near, far = wp.cast(wp.min(least), wp.float32), wp.cast(wp.max(most), wp.float32)
    first, last = ray_of(from_camera, xs[0], ys[0]), ray_of(from_camera, xs[TILE - 1], ys[TILE - 1])
    low = wp.min(wp.min(near * first, far * first), wp.min(near * last, far * last))
    high = wp.max(wp.max(near * first, far * first), wp.max(near * last, far * last))
    return camera + low, camera + high
