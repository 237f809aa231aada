"""Ray intersection, normal, texture coordinates and soft shadow of MuJoCo's primitive geoms, in the
geom's own frame.

Rays are ``o + t * d`` with the origin ``o`` [m] and a direction ``d`` of any length; ``size`` holds
MuJoCo's half-sizes [m]. Only the point where a ray enters a shape counts, so a camera inside one
does not see it; a negative t means that the ray does not enter. Nothing here branches on the ray,
so that a compiler can vectorize over rays.

The light is directional and seen as a small disc. How much of it a shape takes follows from how far
outside the shape's outline, as the light sees it, the ray to the light passes.
"""

import mujoco
import warp as wp

PLANE = wp.constant(int(mujoco.mjtGeom.mjGEOM_PLANE))
SPHERE = wp.constant(int(mujoco.mjtGeom.mjGEOM_SPHERE))
CAPSULE = wp.constant(int(mujoco.mjtGeom.mjGEOM_CAPSULE))
ELLIPSOID = wp.constant(int(mujoco.mjtGeom.mjGEOM_ELLIPSOID))
CYLINDER = wp.constant(int(mujoco.mjtGeom.mjGEOM_CYLINDER))
BOX = wp.constant(int(mujoco.mjtGeom.mjGEOM_BOX))

GEOM_TYPES = frozenset((PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX))

MISS = wp.constant(-1.0)
TINY = wp.constant(1.0e-15)
THIN = wp.constant(1.0e-6)
FLAT = wp.constant(1.0e-4)
"""Least size [m] of a shadow's round end, and least sine between a ray and the sides it may
pass."""
BESIDE_ALL = wp.constant(1.0e3)

wp.set_module_options({"enable_backward": False})


@wp.func
def enter_plane(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return t where a ray enters the front of a rectangle (the +z side)."""
    t = -o[2] / wp.min(d[2], -TINY)
    inside = wp.abs(o[0] + t * d[0]) <= size[0] and wp.abs(o[1] + t * d[1]) <= size[1]
    return wp.where(inside and d[2] < -TINY, t, MISS)


@wp.func
def enter_sphere(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return t where a ray enters a sphere of radius ``size[0]``."""
    return _first_root(wp.dot(d, d), wp.dot(o, d), wp.dot(o, o) - size[0] * size[0])


@wp.func
def enter_ellipsoid(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return t where a ray enters an ellipsoid."""
    return enter_sphere(wp.vec3(1.0), wp.cw_div(o, size), wp.cw_div(d, size))


@wp.func
def enter_capsule(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return t where a ray enters a capsule: where it meets the infinite cylinder beyond an end,
    only that end's sphere can be entered.
    """
    a = d[0] * d[0] + d[1] * d[1]
    b = o[0] * d[0] + o[1] * d[1]
    c = o[0] * o[0] + o[1] * o[1] - size[0] * size[0]
    inside = b * b - a * c
    t = (-b - wp.sqrt(wp.max(inside, 0.0))) / wp.max(a, TINY)
    z = o[2] + t * d[2]
    above = o[2] - wp.clamp(z, -size[1], size[1])
    sphere = _first_root(a + d[2] * d[2], b + above * d[2], c + above * above)
    return wp.where(inside < TINY, MISS, wp.where(wp.abs(z) <= size[1], t, sphere))


@wp.func
def enter_cylinder(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return t where a ray enters a cylinder: inside the infinite cylinder and between its caps."""
    a = wp.max(d[0] * d[0] + d[1] * d[1], TINY)
    b = o[0] * d[0] + o[1] * d[1]
    inside = b * b - a * (o[0] * o[0] + o[1] * o[1] - size[0] * size[0])
    root = wp.sqrt(wp.max(inside, 0.0))
    t = wp.max((-b - root) / a, slab_exit(o[2], d[2], -size[1]))
    end = wp.min((-b + root) / a, slab_exit(o[2], d[2], size[1]))
    return wp.where(inside < TINY or t > end, MISS, t)


@wp.func
def enter_box(size: wp.vec3, o: wp.vec3, d: wp.vec3) -> float:
    """Return t where a ray enters a box: inside all three slabs."""
    x = slab_exit(o[0], d[0], -size[0])
    y = slab_exit(o[1], d[1], -size[1])
    z = slab_exit(o[2], d[2], -size[2])
    t = wp.max(x, wp.max(y, z))
    x = slab_exit(o[0], d[0], size[0])
    y = slab_exit(o[1], d[1], size[1])
    z = slab_exit(o[2], d[2], size[2])
    return wp.where(t > wp.min(x, wp.min(y, z)), MISS, t)


@wp.func
def _first_root(a: float, b: float, c: float) -> float:
    """The smaller solution of a t^2 + 2 b t + c = 0."""
    inside = b * b - a * c
    return wp.where(inside < TINY, MISS, (-b - wp.sqrt(wp.max(inside, 0.0))) / a)


@wp.func
def slab_exit(o: float, d: float, half: float) -> float:
    """Return t where a ray leaves the slab of this half thickness; where it enters, for a negative
    one.
    """
    along = wp.where(wp.abs(d) < TINY, TINY, d)
    return half / wp.abs(along) - o / along


@wp.func
def normal_plane(size: wp.vec3, p: wp.vec3) -> wp.vec3:
    """Return the outward unit normal at a point of a rectangle."""
    return wp.vec3(0.0, 0.0, 1.0)


@wp.func
def normal_sphere(size: wp.vec3, p: wp.vec3) -> wp.vec3:
    """Return the outward unit normal at a point of a sphere."""
    return p / wp.length(p)


@wp.func
def normal_ellipsoid(size: wp.vec3, p: wp.vec3) -> wp.vec3:
    """Return the outward unit normal at a point of an ellipsoid."""
    n = wp.cw_div(wp.cw_div(p, size), size)
    return n / wp.length(n)


@wp.func
def normal_capsule(size: wp.vec3, p: wp.vec3) -> wp.vec3:
    """Return the outward unit normal at a point of a capsule."""
    n = wp.vec3(p[0], p[1], p[2] - wp.clamp(p[2], -size[1], size[1]))
    return n / wp.length(n)


@wp.func
def normal_cylinder(size: wp.vec3, p: wp.vec3) -> wp.vec3:
    """Return the outward unit normal at a point of a cylinder."""
    side = 1.0 / wp.max(wp.sqrt(p[0] * p[0] + p[1] * p[1]), TINY)
    cap = _on_cap(size, p)
    return wp.vec3(
        wp.where(cap, 0.0, p[0] * side),
        wp.where(cap, 0.0, p[1] * side),
        wp.where(cap, wp.sign(p[2]), 0.0),
    )


@wp.func
def normal_box(size: wp.vec3, p: wp.vec3) -> wp.vec3:
    """Return the outward unit normal at a point of a box."""
    face = _face(size, p)
    return wp.vec3(
        wp.where(face == 0, wp.sign(p[0]), 0.0),
        wp.where(face == 1, wp.sign(p[1]), 0.0),
        wp.where(face == 2, wp.sign(p[2]), 0.0),
    )


@wp.func
def _face(size: wp.vec3, p: wp.vec3) -> int:
    """The axis normal to the box's face on which p lies."""
    x = wp.abs(p[0]) - size[0]
    y = wp.abs(p[1]) - size[1]
    z = wp.abs(p[2]) - size[2]
    return wp.where(z >= x and z >= y, 2, wp.where(x >= y, 0, 1))


@wp.func
def _on_cap(size: wp.vec3, p: wp.vec3) -> bool:
    return wp.abs(p[2]) - size[1] >= wp.sqrt(p[0] * p[0] + p[1] * p[1]) - size[0]


@wp.func
def uv_plane(size: wp.vec3, p: wp.vec3) -> wp.vec2:
    """Return the texture coordinates of a point of a rectangle, 0 to 1."""
    return wp.vec2(0.5 + 0.5 * p[0] / size[0], 0.5 - 0.5 * p[1] / size[1])


@wp.func
def uv_box(size: wp.vec3, p: wp.vec3) -> wp.vec2:
    """Return the texture coordinates of a point of a box, 0 to 1 on each face."""
    x = 0.5 * p[0] / size[0]
    y = 0.5 * p[1] / size[1]
    z = 0.5 * p[2] / size[2]
    face = _face(size, p)
    along_u = wp.where(face == 2, x, wp.where(face == 0, wp.sign(p[0]) * y, -wp.sign(p[1]) * x))
    return wp.vec2(0.5 + along_u, 0.5 - wp.where(face == 2, wp.sign(p[2]) * y, z))


@wp.func
def uv_sphere(size: wp.vec3, p: wp.vec3) -> wp.vec2:
    """Return the texture coordinates of a point of a sphere: longitude and latitude."""
    q = p / wp.length(p)
    return wp.vec2(_azimuth(q), 0.5 - wp.asin(wp.clamp(q[2], -1.0, 1.0)) / wp.pi)


@wp.func
def uv_ellipsoid(size: wp.vec3, p: wp.vec3) -> wp.vec2:
    """Return the texture coordinates of a point of an ellipsoid, which is a scaled sphere and has
    the sphere's.
    """
    return uv_sphere(size, wp.cw_div(p, size))


@wp.func
def uv_capsule(size: wp.vec3, p: wp.vec3) -> wp.vec2:
    """Return the texture coordinates of a point of a capsule; its ends repeat the texture of its
    side.
    """
    beyond = wp.clamp((wp.abs(p[2]) - size[1]) / size[0], 0.0, 1.0)
    bend = wp.asin(beyond) * (2.0 / wp.pi)
    end = wp.where(p[2] > 0.0, 1.0 - bend, bend)
    return wp.vec2(_azimuth(p), wp.where(beyond > 0.0, end, 0.5 - 0.5 * p[2] / size[1]))


@wp.func
def uv_cylinder(size: wp.vec3, p: wp.vec3) -> wp.vec2:
    """Return the texture coordinates of a point of a cylinder."""
    cap = _on_cap(size, p)
    u = wp.where(cap, 0.5 + 0.5 * p[0] / size[0], _azimuth(p))
    return wp.vec2(u, wp.where(cap, 0.5 + 0.5 * p[1] / size[0], 0.5 - 0.5 * p[2] / size[1]))


@wp.func
def _azimuth(p: wp.vec3) -> float:
    """Azimuth in full turns, 0 to 1."""
    turn = wp.atan2(p[1], p[0]) * (0.5 / wp.pi)
    return wp.where(turn < 0.0, turn + 1.0, turn)


@wp.func
def shadow_sphere(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share of the light, 0 to 1, that a sphere takes from point ``o``; ``d`` is the way
    to the light.

    Half of the light is taken on the outline, as the light sees the sphere, and the penumbra is as
    wide on either side; it widens with the distance from the shape. ``spread`` is the light's
    angular radius [rad].
    """
    along = wp.max(-wp.dot(o, d), 0.0)
    return _covered(size[0], wp.length(o + along * d), spread * along)


@wp.func
def shadow_ellipsoid(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that an ellipsoid takes: in the space in which it is a sphere."""
    point = wp.cw_div(o, size)
    way = wp.cw_div(d, size)
    along = wp.max(-wp.dot(point, way) / wp.dot(way, way), 0.0)
    return _covered(
        1.0, wp.length(point + along * way), 3.0 * spread * along / (size[0] + size[1] + size[2])
    )


@wp.func
def shadow_capsule(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a capsule takes: from the nearest approach of ray and axis."""
    across = wp.max(d[0] * d[0] + d[1] * d[1], THIN)
    z = wp.clamp(o[2] - d[2] * (o[0] * d[0] + o[1] * d[1]) / across, -size[1], size[1])
    from_axis = wp.vec3(o[0], o[1], o[2] - z)
    along = wp.max(-wp.dot(from_axis, d), 0.0)
    return _covered(size[0], wp.length(from_axis + along * d), spread * along)


@wp.func
def shadow_cylinder(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a cylinder takes: its outline is a rectangle with an ellipse at either
    end.
    """
    a = wp.max(d[0] * d[0] + d[1] * d[1], THIN)
    b = o[0] * d[0] + o[1] * d[1]
    inside = wp.max(b * b - a * (o[0] * o[0] + o[1] * o[1] - size[0] * size[0]), 0.0)
    end = wp.min((wp.sqrt(inside) - b) / a, slab_exit(o[2], d[2], size[1]))
    aslant = wp.sqrt(a)
    radius = size[0]
    flat = wp.max(size[0] * wp.abs(d[2]), FLAT)
    across = wp.where(a > THIN, wp.vec3(d[1] / aslant, -d[0] / aslant, 0.0), wp.vec3(1.0, 0.0, 0.0))
    x = wp.abs(wp.dot(o, across))
    y = wp.abs(wp.dot(o, wp.cross(across, d)))
    beyond = wp.max(y - size[1] * aslant, 0.0)
    slope = wp.vec2(x / (radius * radius), beyond / (flat * flat))
    scale = wp.sqrt(x * slope[0] + beyond * slope[1])
    round = wp.where(beyond > 0.0, scale * (scale - 1.0) / wp.max(wp.length(slope), THIN), -radius)
    outside = wp.max(wp.max(x - radius, y - size[1] * aslant - flat), round)
    return _straight(outside, spread, end)


@wp.func
def shadow_box(size: wp.vec3, spread: float, o: wp.vec3, d: wp.vec3) -> float:
    """Return the share that a box takes: its outline is a hexagon of three pairs of parallel
    sides.
    """
    end = wp.min(
        slab_exit(o[0], d[0], size[0]),
        wp.min(slab_exit(o[1], d[1], size[1]), slab_exit(o[2], d[2], size[2])),
    )
    x = _beside(
        o[1] * d[2] - o[2] * d[1], size[1] * wp.abs(d[2]) + size[2] * wp.abs(d[1]), d[1], d[2]
    )
    y = _beside(
        o[2] * d[0] - o[0] * d[2], size[2] * wp.abs(d[0]) + size[0] * wp.abs(d[2]), d[2], d[0]
    )
    z = _beside(
        o[0] * d[1] - o[1] * d[0], size[0] * wp.abs(d[1]) + size[1] * wp.abs(d[0]), d[0], d[1]
    )
    return _straight(wp.max(x, wp.max(y, z)), spread, end)


@wp.func
def _beside(along: float, half: float, d1: float, d2: float) -> float:
    """Distance [m] at which a ray passes outside a pair of sides, if its direction has these parts
    across them.
    """
    aslant = wp.sqrt(d1 * d1 + d2 * d2)
    return wp.where(aslant < FLAT, -BESIDE_ALL, (wp.abs(along) - half) / wp.max(aslant, FLAT))


@wp.func
def _covered(radius: float, passing: float, wider: float) -> float:
    """Share of the light's disc behind a disc of this radius, which the ray passes at this distance
    from its center.
    """
    return _half_shadow(passing - radius, wider) * wp.min(radius / (wider + THIN), 1.0)


@wp.func
def _straight(outside: float, spread: float, end: float) -> float:
    """Share of the light that a ray loses which passes this far outside an outline and leaves the
    shape at ``end``.
    """
    return wp.where(end > 0.0, _half_shadow(outside, spread * end), 0.0)


@wp.func
def _half_shadow(outside: float, wider: float) -> float:
    """Share of the light's disc behind an edge that a ray passes this far outside [m]; half of it
    on the edge.
    """
    share = wp.clamp(0.5 - outside / (2.0 * wider + THIN), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


@wp.func
def textured_half_size(geom_type: int, size: wp.vec3) -> float:
    """Return half of the length [m] over which the texture of a shape repeats once, along its
    shorter side.
    """
    if geom_type == PLANE:
        return wp.min(size[0], size[1])
    if geom_type == BOX:
        return size[0] + size[1] + size[2] - wp.max(size) - wp.min(size)
    return 1.5 * size[0]
