"""Soft shadows: how much of the light a shape takes from a point.

The light is directional and seen as a small disc, so a shadow's edge widens with the distance from what casts it. For
round shapes the width follows from how closely the ray to the light passes by, for boxes and cylinders from how far it
runs through the shape.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.pixel_rows import Indices, Row, ray_of
from dynahoi_lerobot.renderers.raycast.shapes import BOX, CAPSULE, CYLINDER, ELLIPSOID, slab_exit
from dynahoi_lerobot.renderers.raycast.tiling import TILE, Shape
from dynahoi_lerobot.renderers.raycast.tracing import LightFrame, Worlds

SPREAD = wp.constant(0.02)
"""Half of the penumbra's width, per distance from what casts the shadow: the light's angular radius [rad]."""
TINY = wp.constant(1.0e-6)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.func
def shadow_sphere(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share of the light, 0 to 1, that a sphere takes from point ``o``; ``d`` is the way to the light."""
    along = wp.max(-wp.dot(o, d), 0.0)
    passing = o + along * d
    return _covered(size[0], wp.dot(passing, passing), SPREAD * along)


@wp.func
def shadow_ellipsoid(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that an ellipsoid takes: in the space in which it is a sphere."""
    point, way = wp.cw_div(o, size), wp.cw_div(d, size)
    along = wp.max(-wp.dot(point, way) / wp.dot(way, way), 0.0)
    passing = point + along * way
    return _covered(1.0, wp.dot(passing, passing), 3.0 * SPREAD * along / (size[0] + size[1] + size[2]))


@wp.func
def shadow_capsule(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a capsule takes: from the nearest approach of ray and axis."""
    across = wp.max(d[0] * d[0] + d[1] * d[1], TINY)
    z = wp.clamp(o[2] - d[2] * (o[0] * d[0] + o[1] * d[1]) / across, -size[1], size[1])
    from_axis = wp.vec3(o[0], o[1], o[2] - z)
    along = wp.max(-wp.dot(from_axis, d), 0.0)
    passing = from_axis + along * d
    return _covered(size[0], wp.dot(passing, passing), SPREAD * along)


@wp.func
def shadow_cylinder(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a cylinder takes: from the length of the ray inside one that the penumbra widens."""
    wider = SPREAD * wp.max(-wp.dot(o, d), 0.0)
    grown = wp.vec3(size[0] + wider, size[1] + wider, 0.0)
    a, b = wp.max(d[0] * d[0] + d[1] * d[1], TINY), o[0] * d[0] + o[1] * d[1]
    inside = b * b - a * (o[0] * o[0] + o[1] * o[1] - grown[0] * grown[0])
    root = wp.sqrt(wp.max(inside, 0.0))
    begin = wp.max((-b - root) / a, slab_exit(o[2], d[2], -grown[1]))
    end = wp.min((-b + root) / a, slab_exit(o[2], d[2], grown[1]))
    return wp.where(inside <= 0.0, 0.0, _thickness(begin, end, wider))


@wp.func
def shadow_box(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a box takes: from the length of the ray inside one that the penumbra widens."""
    wider = SPREAD * wp.max(-wp.dot(o, d), 0.0)
    x, y, z = size[0] + wider, size[1] + wider, size[2] + wider
    begin = wp.max(slab_exit(o[0], d[0], -x), wp.max(slab_exit(o[1], d[1], -y), slab_exit(o[2], d[2], -z)))
    end = wp.min(slab_exit(o[0], d[0], x), wp.min(slab_exit(o[1], d[1], y), slab_exit(o[2], d[2], z)))
    return _thickness(begin, end, wider)


@wp.func
def _covered(radius: float, passing_squared: float, wider: float) -> float:
    """Share of the light's disc behind a disc of this radius, which the ray passes at this distance from its centre."""
    outer = radius + wider
    share = wp.clamp((outer * outer - passing_squared) / (4.0 * radius * wider + TINY), 0.0, 1.0)
    return _smooth(share) * wp.min(radius / (wider + TINY), 1.0)


@wp.func
def _thickness(begin: float, end: float, wider: float) -> float:
    """Share of the light that a ray loses which is inside a shape, widened by the penumbra, from begin to end."""
    return _smooth(wp.clamp((end - wp.max(begin, 0.0)) / (4.0 * wider + TINY), 0.0, 1.0))


@wp.func
def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)


def _shading(shadow: wp.Function) -> wp.Function:
    """Return a function that computes what one type of shape takes from the points of a row."""

    @wp.func
    def shaded(shape: Shape, depths: Row, xs: Row, ys: Row) -> Row:
        row = Row()
        for i in range(TILE):
            point = shape.camera + depths[i] * ray_of(shape.from_camera, xs[i], ys[i])
            row[i] = shadow(shape.size, point, shape.to_light)
        return row

    return shaded


_shade_sphere, _shade_capsule, _shade_box = _shading(shadow_sphere), _shading(shadow_capsule), _shading(shadow_box)
_shade_cylinder, _shade_ellipsoid = _shading(shadow_cylinder), _shading(shadow_ellipsoid)


@wp.func
def _shade(shape: Shape, depths: Row, xs: Row, ys: Row) -> Row:
    if shape.geom_type == CAPSULE:
        return _shade_capsule(shape, depths, xs, ys)
    if shape.geom_type == BOX:
        return _shade_box(shape, depths, xs, ys)
    if shape.geom_type == CYLINDER:
        return _shade_cylinder(shape, depths, xs, ys)
    if shape.geom_type == ELLIPSOID:
        return _shade_ellipsoid(shape, depths, xs, ys)
    return _shade_sphere(shape, depths, xs, ys)


@wp.func
def sunlight_row(worlds: Worlds, w: int, tile: int, depths: Row, visible: Indices, xs: Row, ys: Row) -> Row:
    """Return the share of the light, 0 to 1, that reaches the points of a row; no shape shades itself."""
    row = Row(1.0)
    frame = worlds.light_frames[w]
    low, high = _row_bounds(frame, depths, visible, xs, ys)
    for k in range(worlds.caster_counts[w, tile]):
        s = worlds.casters[w, tile, k]
        if may_shade(worlds.caster_lows[w, s], worlds.caster_highs[w, s], low, high):
            taken = _shade(worlds.shapes[w, s], depths, xs, ys)
            alpha = worlds.shapes[w, s].alpha
            for i in range(TILE):
                left = wp.where(visible[i] == s, 1.0, 1.0 - alpha * taken[i])
                row[i] = wp.min(row[i], left)
    return row


@wp.func
def _row_bounds(frame: LightFrame, depths: Row, visible: Indices, xs: Row, ys: Row) -> tuple[wp.vec3, wp.vec3]:
    """Lower and upper corner [m], light frame, of a box around the points of a row, whose rays lie in a plane."""
    farthest = Row()
    for i in range(TILE):
        farthest[i] = wp.where(visible[i] >= 0, depths[i], 0.0)
    near, far = wp.min(depths), wp.max(farthest)
    first, last = ray_of(frame.from_camera, xs[0], ys[0]), ray_of(frame.from_camera, xs[TILE - 1], ys[TILE - 1])
    low = wp.min(wp.min(near * first, far * first), wp.min(near * last, far * last))
    high = wp.max(wp.max(near * first, far * first), wp.max(near * last, far * last))
    return frame.camera + low, frame.camera + high


@wp.func
def may_shade(caster_low: wp.vec3, caster_high: wp.vec3, low: wp.vec3, high: wp.vec3) -> bool:
    """Tell whether something in one box may shade something in another; corners [m], light frame."""
    edge = SPREAD * wp.max(caster_high[2] - low[2], 0.0)
    beside = caster_low[0] - edge > high[0] or caster_high[0] + edge < low[0]
    beside = beside or caster_low[1] - edge > high[1] or caster_high[1] + edge < low[1]
    return caster_high[2] > low[2] and not beside
