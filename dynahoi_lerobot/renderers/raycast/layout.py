"""What a frame shows and where: shapes ready for rays, and the lists of shapes that each tile may show."""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.shapes import BOX, ELLIPSOID, PLANE, SPHERE

TILE = wp.constant(16)
"""Side of a tile [px]."""
FAR = wp.constant(1.0e10)
PLAIN_GLOSS = wp.constant(0.5)
"""What geoms without a material throw back, as in MuJoCo; materials of this scene throw back all of it."""
NEAREST_DEPTH = wp.constant(0.01)
"""A shape that comes closer to the camera's plane than this [m] may show anywhere."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class Lens:
    """The camera: its number in the model, side of the square picture [px], distance of the image plane [px]."""

    camera: int
    size: int
    focal: float


@wp.struct
class Shape:
    """A geom of one world, ready for rays from the camera; vectors in its own frame.

    Attributes:
        kind: MuJoCo's type of geom; ``size``: half-sizes [m]; ``tint``: its colour.
        camera: position of the camera [m]; ``from_camera``: rotation from the camera's axes.
        sun: direction towards the light.
        texture: index, -1 for none; ``repeat``: how often it repeats across the shape.
        alpha: opacity; ``gloss``: how much of the light's highlight it throws back.
    """

    kind: int
    size: wp.vec3
    tint: wp.vec3
    camera: wp.vec3
    from_camera: wp.mat33
    sun: wp.vec3
    texture: int
    repeat: wp.vec2
    alpha: float
    gloss: float


@wp.kernel
def place(
    lens: Lens,
    shown: wp.array[int],
    kinds: wp.array[int],
    texture_of: wp.array[int],
    repeat_of: wp.array[wp.vec2],
    geom_size: wp.array2d[wp.vec3],
    geom_rgba: wp.array2d[wp.vec4],
    geom_matid: wp.array2d[int],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    cam_xpos: wp.array2d[wp.vec3],
    cam_xmat: wp.array2d[wp.mat33],
    light_xdir: wp.array2d[wp.vec3],
    shapes: wp.array2d[Shape],
    outlines: wp.array2d[wp.vec4],
):
    """Fill in a shape and its outline's least and greatest column and row [px]; (world, shape)."""
    w, s = wp.tid()
    geom = shown[s]
    to_shape = wp.transpose(geom_xmat[w, geom])
    rgba = geom_rgba[w, geom]
    shape = Shape()
    shape.kind = kinds[s]
    shape.size = geom_size[w, geom]
    shape.tint = wp.vec3(rgba[0], rgba[1], rgba[2])
    shape.camera = to_shape * (cam_xpos[w, lens.camera] - geom_xpos[w, geom])
    shape.from_camera = to_shape * cam_xmat[w, lens.camera]
    shape.sun = -(to_shape * light_xdir[w, 0])
    shape.alpha = rgba[3]
    shape.gloss = PLAIN_GLOSS
    shape.texture = -1
    if geom_matid[w, geom] >= 0:
        shape.gloss = 1.0
        shape.texture = texture_of[geom_matid[w, geom]]
        shape.repeat = repeat_of[geom_matid[w, geom]]
    shapes[w, s] = shape
    outlines[w, s] = wp.vec4(FAR, -FAR, FAR, -FAR)
    if rgba[3] > 0.0:
        outlines[w, s] = _outline(lens, shape)


@wp.func
def _outline(lens: Lens, shape: Shape) -> wp.vec4:
    to_camera = wp.transpose(shape.from_camera)
    center = -(to_camera * shape.camera)
    if shape.kind == BOX:
        return _box_outline(lens, center, to_camera, shape.size)
    if shape.kind == PLANE:
        return wp.vec4(-FAR, FAR, -FAR, FAR)
    if shape.kind == SPHERE:
        return _ball_outline(lens, center, shape.size[0])
    if shape.kind == ELLIPSOID:
        return _ball_outline(lens, center, wp.max(shape.size))
    end = to_camera * wp.vec3(0.0, 0.0, shape.size[1])
    return _around(_ball_outline(lens, center - end, shape.size[0]), _ball_outline(lens, center + end, shape.size[0]))


@wp.func
def _box_outline(lens: Lens, center: wp.vec3, to_camera: wp.mat33, size: wp.vec3) -> wp.vec4:
    outline = wp.vec4(FAR, -FAR, FAR, -FAR)
    for corner in range(8):
        x = size[0] * (2.0 * float(corner & 1) - 1.0)
        y = size[1] * (float(corner & 2) - 1.0)
        z = size[2] * (0.5 * float(corner & 4) - 1.0)
        outline = _around(outline, _ball_outline(lens, center + to_camera * wp.vec3(x, y, z), 0.0))
    return outline


@wp.func
def _ball_outline(lens: Lens, center: wp.vec3, radius: float) -> wp.vec4:
    depth = -center[2]
    if depth - radius < NEAREST_DEPTH:
        return wp.vec4(-FAR, FAR, -FAR, FAR)
    x, y = _span(center[0], depth, radius), _span(-center[1], depth, radius)
    half = 0.5 * float(lens.size)
    return wp.vec4(x[0], x[1], y[0], y[1]) * lens.focal + wp.vec4(half, half, half, half)


@wp.func
def _span(aside: float, depth: float, radius: float) -> wp.vec2:
    """Slopes of the two lines through the camera that touch a disc."""
    room = depth * depth - radius * radius
    root = radius * wp.sqrt(room + aside * aside)
    return wp.vec2(aside * depth - root, aside * depth + root) / room


@wp.func
def _around(a: wp.vec4, b: wp.vec4) -> wp.vec4:
    return wp.vec4(wp.min(a[0], b[0]), wp.max(a[1], b[1]), wp.min(a[2], b[2]), wp.max(a[3], b[3]))


@wp.kernel
def sort_into_tiles(across: int, outlines: wp.array2d[wp.vec4], lists: wp.array3d[int], counts: wp.array2d[int]):
    """List the shapes that a tile may show, in the order of the geoms; (world, tile)."""
    w, tile = wp.tid()
    left, top = float((tile % across) * TILE), float((tile // across) * TILE)
    count = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
    for s in range(outlines.shape[1]):
        o = outlines[w, s]
        if o[0] < left + float(TILE) and o[1] > left and o[2] < top + float(TILE) and o[3] > top:
            lists[w, tile, count] = s
            count += 1
    counts[w, tile] = count
