"""One shape and sixteen rays from the camera: depth, lighting and texture at the points where they enter the shape.

The loops over the rays hold no branches and stay loops, so that compilers turn them into vector instructions; that is
most of the speed on a CPU. Ray i has the direction ``(xs[i], ys[i], -1)`` in the camera's frame.
"""

# ruff: noqa: PLR0917 - warp functions take their arguments by position

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
from dynahoi_lerobot.renderers.raycast.textures import Textures, level_of, texel
from dynahoi_lerobot.renderers.raycast.tiling import TILE, Shape
from dynahoi_lerobot.scene.model import SHININESS

Row = wp.types.vector(TILE, wp.float32)
HIGHLIGHT_EXPONENT = wp.constant(128.0 * SHININESS)
"""Blinn exponent, computed as OpenGL does."""
Indices = wp.types.vector(TILE, wp.int32)

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.func
def ray_of(from_camera: wp.mat33, x: float, y: float) -> wp.vec3:
    """Return the direction (x, y, -1) of the camera's frame, turned into another frame."""
    return wp.vec3(
        from_camera[0, 0] * x + from_camera[0, 1] * y - from_camera[0, 2],
        from_camera[1, 0] * x + from_camera[1, 1] * y - from_camera[1, 2],
        from_camera[2, 0] * x + from_camera[2, 1] * y - from_camera[2, 2],
    )


def _entering(enter: wp.Function) -> wp.Function:
    """Return a function that intersects one type of shape with every ray of a row."""

    @wp.func
    def entered(size: wp.vec3, o: wp.vec3, from_camera: wp.mat33, xs: Row, ys: Row) -> Row:
        row = Row()
        for i in range(TILE):
            row[i] = enter(size, o, ray_of(from_camera, xs[i], ys[i]))
        return row

    return entered


def _lighting(normal: wp.Function) -> wp.Function:
    """Return a function that computes the lighting at the points of a row."""

    @wp.func
    def lit(shape: Shape, fill: wp.vec3, depths: Row, xs: Row, ys: Row, shiny: bool) -> tuple[Row, Row, Row]:
        diffuse = Row()
        filled = Row()
        highlight = Row(0.0)
        for i in range(TILE):
            n = normal(shape.size, shape.camera + depths[i] * ray_of(shape.from_camera, xs[i], ys[i]))
            diffuse[i] = wp.dot(n, shape.to_light)
            filled[i] = wp.dot(n, fill)
        if shiny:
            for i in range(TILE):
                ray = ray_of(shape.from_camera, xs[i], ys[i])
                n = normal(shape.size, shape.camera + depths[i] * ray)
                halfway = wp.normalize(shape.to_light - wp.normalize(ray))
                facing = wp.where(diffuse[i] > 0.0, wp.dot(n, halfway), 0.0)
                highlight[i] = wp.pow(wp.max(facing, 0.0), HIGHLIGHT_EXPONENT)
        return diffuse, filled, highlight

    return lit


def _texturing(uv: wp.Function, normal: wp.Function) -> wp.Function:
    """Return a function that samples the shape's texture at the points of a row."""

    @wp.func
    def textured(shape: Shape, textures: Textures, pixel_rad: float, middle: int, depths: Row, xs: Row, ys: Row) -> Row:
        row = Row()
        ray = ray_of(shape.from_camera, xs[middle], ys[middle])
        n = normal(shape.size, shape.camera + depths[middle] * ray)
        facing = wp.abs(wp.dot(n, ray)) / wp.length(ray)
        level = level_of(textures, shape.repeats_per_m * depths[middle] * pixel_rad, facing)
        start, side = shape.texture * textures.texels_each + textures.starts[level], textures.sides[level]
        for i in range(TILE):
            at = uv(shape.size, shape.camera + depths[i] * ray_of(shape.from_camera, xs[i], ys[i]))
            at = wp.cw_mul(at, shape.repeat)
            row[i] = texel(
                textures.texels, start, side, textures.filtered, at[0] - wp.floor(at[0]), at[1] - wp.floor(at[1])
            )
        return row

    return textured


_enter_plane, _light_plane = _entering(enter_plane), _lighting(normal_plane)
_enter_sphere, _light_sphere = _entering(enter_sphere), _lighting(normal_sphere)
_enter_capsule, _light_capsule = _entering(enter_capsule), _lighting(normal_capsule)
_enter_cylinder, _light_cylinder = _entering(enter_cylinder), _lighting(normal_cylinder)
_enter_ellipsoid, _light_ellipsoid = _entering(enter_ellipsoid), _lighting(normal_ellipsoid)
_enter_box, _light_box = _entering(enter_box), _lighting(normal_box)
_texture_plane, _texture_sphere = _texturing(uv_plane, normal_plane), _texturing(uv_sphere, normal_sphere)
_texture_capsule, _texture_box = _texturing(uv_capsule, normal_capsule), _texturing(uv_box, normal_box)
_texture_cylinder = _texturing(uv_cylinder, normal_cylinder)
_texture_ellipsoid = _texturing(uv_ellipsoid, normal_ellipsoid)


@wp.func
def enter_row(geom_type: int, size: wp.vec3, o: wp.vec3, from_camera: wp.mat33, xs: Row, ys: Row) -> Row:
    """Return the depths [m] at which a row of rays from ``o`` enters a shape, negative where it does not."""
    if geom_type == PLANE:
        return _enter_plane(size, o, from_camera, xs, ys)
    if geom_type == CAPSULE:
        return _enter_capsule(size, o, from_camera, xs, ys)
    if geom_type == BOX:
        return _enter_box(size, o, from_camera, xs, ys)
    if geom_type == CYLINDER:
        return _enter_cylinder(size, o, from_camera, xs, ys)
    if geom_type == ELLIPSOID:
        return _enter_ellipsoid(size, o, from_camera, xs, ys)
    return _enter_sphere(size, o, from_camera, xs, ys)


@wp.func
def light_row(shape: Shape, fill: wp.vec3, depths: Row, xs: Row, ys: Row, shiny: bool) -> tuple[Row, Row, Row]:
    """Return the cosines between normal and light and between normal and ``fill``, and if ``shiny`` the highlight.

    Highlights follow Blinn (1977).
    """
    if shape.geom_type == PLANE:
        return _light_plane(shape, fill, depths, xs, ys, shiny)
    if shape.geom_type == CAPSULE:
        return _light_capsule(shape, fill, depths, xs, ys, shiny)
    if shape.geom_type == BOX:
        return _light_box(shape, fill, depths, xs, ys, shiny)
    if shape.geom_type == CYLINDER:
        return _light_cylinder(shape, fill, depths, xs, ys, shiny)
    if shape.geom_type == ELLIPSOID:
        return _light_ellipsoid(shape, fill, depths, xs, ys, shiny)
    return _light_sphere(shape, fill, depths, xs, ys, shiny)


@wp.func
def texture_row(shape: Shape, textures: Textures, pixel_rad: float, middle: int, depths: Row, xs: Row, ys: Row) -> Row:
    """Return the brightness of the shape's texture, 0 to 1, as sharp as ray ``middle`` of those that show it allows.

    Args:
        shape: the shape.
        textures: of the scene.
        pixel_rad: angle between the rays of neighbouring pixels [rad].
        middle: number of a ray that shows the shape.
        depths: of the points [m].
        xs, ys: slopes of the rays in the camera's frame.
    """
    if shape.geom_type == PLANE:
        return _texture_plane(shape, textures, pixel_rad, middle, depths, xs, ys)
    if shape.geom_type == CAPSULE:
        return _texture_capsule(shape, textures, pixel_rad, middle, depths, xs, ys)
    if shape.geom_type == BOX:
        return _texture_box(shape, textures, pixel_rad, middle, depths, xs, ys)
    if shape.geom_type == CYLINDER:
        return _texture_cylinder(shape, textures, pixel_rad, middle, depths, xs, ys)
    if shape.geom_type == ELLIPSOID:
        return _texture_ellipsoid(shape, textures, pixel_rad, middle, depths, xs, ys)
    return _texture_sphere(shape, textures, pixel_rad, middle, depths, xs, ys)
