"""One shape and one row of pixels: depth, lighting and texture at the points where the row's rays enter the shape.

The loops over the pixels hold no branches and stay loops, so that compilers turn them into vector instructions; that is
most of the speed on a CPU. Rays are ``first + i * step`` in the shape's frame.
"""

from __future__ import annotations

import warp as wp

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
from dynahoi_lerobot.renderers.raycast.tiling import TILE, Shape
from dynahoi_lerobot.scene.model import SHININESS

Row = wp.types.vector(TILE, wp.float32)
HIGHLIGHT_EXPONENT = wp.constant(128.0 * SHININESS)
"""Blinn exponent, computed as OpenGL does."""
Indices = wp.types.vector(TILE, wp.int32)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


def _entering(enter: wp.Function) -> wp.Function:
    """Return a function that intersects one type of shape with every ray of a row."""

    @wp.func
    def entered(size: wp.vec3, o: wp.vec3, first: wp.vec3, step: wp.vec3) -> Row:
        row = Row()
        for i in range(TILE):
            row[i] = enter(size, o, first + float(i) * step)
        return row

    return entered


def _lighting(normal: wp.Function) -> wp.Function:
    """Return a function that computes diffuse and specular lighting at the points of a row."""

    @wp.func
    def lit(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, shiny: bool) -> tuple[Row, Row, Row]:
        diffuse = Row()
        headlight = Row()
        highlight = Row(0.0)
        for i in range(TILE):
            n = normal(shape.size, shape.camera + depths[i] * (first + float(i) * step))
            diffuse[i] = wp.max(0.0, wp.dot(n, shape.to_light))
            headlight[i] = wp.max(0.0, wp.dot(n, shape.from_camera * wp.vec3(0.0, 0.0, 1.0)))
        if shiny:
            for i in range(TILE):
                ray = first + float(i) * step
                n = normal(shape.size, shape.camera + depths[i] * ray)
                halfway = wp.normalize(shape.to_light - wp.normalize(ray))
                facing = wp.where(diffuse[i] > 0.0, wp.dot(n, halfway), 0.0)
                highlight[i] = wp.pow(wp.max(facing, 0.0), HIGHLIGHT_EXPONENT)
        return diffuse, headlight, highlight

    return lit


def _texturing(uv: wp.Function) -> wp.Function:
    """Return a function that samples the shape's texture at the points of a row."""

    @wp.func
    def textured(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, textures: wp.array3d[float]) -> Row:
        row = Row()
        for i in range(TILE):
            at = wp.cw_mul(uv(shape.size, shape.camera + depths[i] * (first + float(i) * step)), shape.repeat)
            row[i] = _texel(textures, shape.texture, at[0] - wp.floor(at[0]), at[1] - wp.floor(at[1]))
        return row

    return textured


_enter_plane, _light_plane, _texture_plane = _entering(enter_plane), _lighting(normal_plane), _texturing(uv_plane)
_enter_sphere, _light_sphere, _texture_sphere = _entering(enter_sphere), _lighting(normal_sphere), _texturing(uv_sphere)
_enter_capsule, _light_capsule = _entering(enter_capsule), _lighting(normal_capsule)
_enter_cylinder, _light_cylinder = _entering(enter_cylinder), _lighting(normal_cylinder)
_enter_ellipsoid, _light_ellipsoid = _entering(enter_ellipsoid), _lighting(normal_ellipsoid)
_texture_capsule, _texture_cylinder, _texture_ellipsoid = (
    _texturing(uv_capsule),
    _texturing(uv_cylinder),
    _texturing(uv_ellipsoid),
)
_enter_box, _light_box, _texture_box = _entering(enter_box), _lighting(normal_box), _texturing(uv_box)


@wp.func
def enter_row(geom_type: int, size: wp.vec3, o: wp.vec3, first: wp.vec3, step: wp.vec3) -> Row:
    """Return the depths [m] at which a row of rays from ``o`` enters a shape, negative where it does not."""
    if geom_type == PLANE:
        return _enter_plane(size, o, first, step)
    if geom_type == CAPSULE:
        return _enter_capsule(size, o, first, step)
    if geom_type == BOX:
        return _enter_box(size, o, first, step)
    if geom_type == CYLINDER:
        return _enter_cylinder(size, o, first, step)
    if geom_type == ELLIPSOID:
        return _enter_ellipsoid(size, o, first, step)
    return _enter_sphere(size, o, first, step)


@wp.func
def light_row(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, shiny: bool) -> tuple[Row, Row, Row]:
    """Return the cosines of incidence of light and headlight, and if ``shiny`` the highlight (Blinn, 1977)."""
    if shape.geom_type == PLANE:
        return _light_plane(shape, depths, first, step, shiny)
    if shape.geom_type == CAPSULE:
        return _light_capsule(shape, depths, first, step, shiny)
    if shape.geom_type == BOX:
        return _light_box(shape, depths, first, step, shiny)
    if shape.geom_type == CYLINDER:
        return _light_cylinder(shape, depths, first, step, shiny)
    if shape.geom_type == ELLIPSOID:
        return _light_ellipsoid(shape, depths, first, step, shiny)
    return _light_sphere(shape, depths, first, step, shiny)


@wp.func
def texture_row(shape: Shape, depths: Row, first: wp.vec3, step: wp.vec3, textures: wp.array3d[float]) -> Row:
    """Return the brightness of the shape's texture, 0 to 1, bilinearly interpolated."""
    if shape.geom_type == PLANE:
        return _texture_plane(shape, depths, first, step, textures)
    if shape.geom_type == CAPSULE:
        return _texture_capsule(shape, depths, first, step, textures)
    if shape.geom_type == BOX:
        return _texture_box(shape, depths, first, step, textures)
    if shape.geom_type == CYLINDER:
        return _texture_cylinder(shape, depths, first, step, textures)
    if shape.geom_type == ELLIPSOID:
        return _texture_ellipsoid(shape, depths, first, step, textures)
    return _texture_sphere(shape, depths, first, step, textures)


@wp.func
def _texel(textures: wp.array3d[float], index: int, u: float, v: float) -> float:
    """Bilinear interpolation between a texture's four nearest pixels; edges do not wrap around."""
    last = textures.shape[1] - 1
    x, y = u * float(last + 1) - 0.5, v * float(last + 1) - 0.5
    x0, y0 = wp.floor(x), wp.floor(y)
    left, right = wp.max(int(x0), 0), wp.min(int(x0) + 1, last)
    upper, lower = wp.max(int(y0), 0), wp.min(int(y0) + 1, last)
    above = wp.lerp(textures[index, upper, left], textures[index, upper, right], x - x0)
    below = wp.lerp(textures[index, lower, left], textures[index, lower, right], x - x0)
    return wp.lerp(above, below, y - y0)
