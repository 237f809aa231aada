"""One shape and one row of pixels: where its rays enter the shape, how it is lit there, what its texture is there.

The loops over the pixels hold no branches and stay loops, so that compilers turn them into vector instructions; that is
most of the speed on a CPU. Rays are ``first + i * step`` in the shape's frame.
"""

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.layout import TILE, Shape
from dynahoi_lerobot.renderers.raycast.shapes import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    enter_box,
    enter_capsule,
    enter_cylinder,
    enter_ellipsoid,
    enter_plane,
    enter_sphere,
    normal_box,
    normal_capsule,
    normal_cylinder,
    normal_ellipsoid,
    normal_plane,
    normal_sphere,
    uv_box,
    uv_capsule,
    uv_cylinder,
    uv_ellipsoid,
    uv_plane,
    uv_sphere,
)
from dynahoi_lerobot.scene.scene import SHININESS

Row = wp.types.vector(TILE, wp.float32)
HIGHLIGHT_EXPONENT = wp.constant(128.0 * SHININESS)
"""As OpenGL's."""
Indices = wp.types.vector(TILE, wp.int32)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


def _entering(enter: wp.Function) -> wp.Function:
    """Return a function that tries one shape on every ray of a row; rays are ``first + i * step``."""

    @wp.func
    def entered(size: wp.vec3, o: wp.vec3, first: wp.vec3, step: wp.vec3) -> Row:
        row = Row()
        for i in range(TILE):
            row[i] = enter(size, o, first + float(i) * step)
        return row

    return entered


def _lighting(normal: wp.Function) -> wp.Function:
    """Return a function that finds how the sun and the headlight light the points of a row."""

    @wp.func
    def lit(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, shiny: bool) -> tuple[Row, Row, Row]:
        sun = Row()
        front = Row()
        highlight = Row(0.0)
        for i in range(TILE):
            n = normal(shape.size, shape.camera + depths[i] * (first + float(i) * step))
            sun[i] = wp.max(0.0, wp.dot(n, shape.sun))
            front[i] = wp.max(0.0, wp.dot(n, shape.from_camera * wp.vec3(0.0, 0.0, 1.0)))
        if shiny:
            for i in range(TILE):
                ray = first + float(i) * step
                n = normal(shape.size, shape.camera + depths[i] * ray)
                halfway = wp.normalize(shape.sun - wp.normalize(ray))
                facing = wp.where(sun[i] > 0.0, wp.dot(n, halfway), 0.0)
                highlight[i] = wp.pow(wp.max(facing, 0.0), HIGHLIGHT_EXPONENT)
        return sun, front, highlight

    return lit


def _papering(uv: wp.Function) -> wp.Function:
    """Return a function that reads the shape's texture at the points of a row."""

    @wp.func
    def papered(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, textures: wp.array3d[float]) -> Row:
        row = Row()
        for i in range(TILE):
            at = wp.cw_mul(uv(shape.size, shape.camera + depths[i] * (first + float(i) * step)), shape.repeat)
            row[i] = _texel(textures, shape.texture, at[0] - wp.floor(at[0]), at[1] - wp.floor(at[1]))
        return row

    return papered


_enter_plane, _light_plane, _paper_plane = _entering(enter_plane), _lighting(normal_plane), _papering(uv_plane)
_enter_sphere, _light_sphere, _paper_sphere = _entering(enter_sphere), _lighting(normal_sphere), _papering(uv_sphere)
_enter_capsule, _light_capsule = _entering(enter_capsule), _lighting(normal_capsule)
_enter_cylinder, _light_cylinder = _entering(enter_cylinder), _lighting(normal_cylinder)
_enter_ellipsoid, _light_ellipsoid = _entering(enter_ellipsoid), _lighting(normal_ellipsoid)
_paper_capsule, _paper_cylinder, _paper_ellipsoid = (
    _papering(uv_capsule),
    _papering(uv_cylinder),
    _papering(uv_ellipsoid),
)
_enter_box, _light_box, _paper_box = _entering(enter_box), _lighting(normal_box), _papering(uv_box)


@wp.func
def enter_row(kind: int, size: wp.vec3, o: wp.vec3, first: wp.vec3, step: wp.vec3) -> Row:
    """Return the depths [m] at which rays from ``o`` enter a shape, negative where they do not."""
    if kind == PLANE:
        return _enter_plane(size, o, first, step)
    if kind == CAPSULE:
        return _enter_capsule(size, o, first, step)
    if kind == BOX:
        return _enter_box(size, o, first, step)
    if kind == CYLINDER:
        return _enter_cylinder(size, o, first, step)
    if kind == ELLIPSOID:
        return _enter_ellipsoid(size, o, first, step)
    return _enter_sphere(size, o, first, step)


@wp.func
def light_row(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, shiny: bool) -> tuple[Row, Row, Row]:
    """Return how squarely sun and headlight meet the surface, and if asked the sun's highlight (Blinn, 1977)."""
    if shape.kind == PLANE:
        return _light_plane(shape, depths, first, step, shiny)
    if shape.kind == CAPSULE:
        return _light_capsule(shape, depths, first, step, shiny)
    if shape.kind == BOX:
        return _light_box(shape, depths, first, step, shiny)
    if shape.kind == CYLINDER:
        return _light_cylinder(shape, depths, first, step, shiny)
    if shape.kind == ELLIPSOID:
        return _light_ellipsoid(shape, depths, first, step, shiny)
    return _light_sphere(shape, depths, first, step, shiny)


@wp.func
def paper_row(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, textures: wp.array3d[float]) -> Row:
    """Return the brightness of the shape's texture, 0 to 1."""
    if shape.kind == PLANE:
        return _paper_plane(shape, depths, first, step, textures)
    if shape.kind == CAPSULE:
        return _paper_capsule(shape, depths, first, step, textures)
    if shape.kind == BOX:
        return _paper_box(shape, depths, first, step, textures)
    if shape.kind == CYLINDER:
        return _paper_cylinder(shape, depths, first, step, textures)
    if shape.kind == ELLIPSOID:
        return _paper_ellipsoid(shape, depths, first, step, textures)
    return _paper_sphere(shape, depths, first, step, textures)


@wp.func
def _texel(textures: wp.array3d[float], index: int, u: float, v: float) -> float:
    """Brightness between a texture's four nearest pixels; edges do not wrap around."""
    last = textures.shape[1] - 1
    x, y = u * float(last + 1) - 0.5, v * float(last + 1) - 0.5
    x0, y0 = wp.floor(x), wp.floor(y)
    left, right = wp.max(int(x0), 0), wp.min(int(x0) + 1, last)
    upper, lower = wp.max(int(y0), 0), wp.min(int(y0) + 1, last)
    above = wp.lerp(textures[index, upper, left], textures[index, upper, right], x - x0)
    below = wp.lerp(textures[index, lower, left], textures[index, lower, right], x - x0)
    return wp.lerp(above, below, y - y0)
