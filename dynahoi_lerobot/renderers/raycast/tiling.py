"""Per frame: geoms brought into a form that is cheap to intersect, and listed with the image tiles
that they matter to.

A tile lists the shapes that its pixels may show and, once those are traced, the shapes that may
shade what it shows.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from collections.abc import Mapping
from typing import Any

import warp as wp

from dynahoi_lerobot.renderers.raycast.shapes import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    enter_box,
    enter_plane,
    textured_half_size,
)

TILE = wp.constant(16)
"""Side of a tile [px]."""
FAR = wp.constant(1.0e10)
PLAIN_SPECULARITY = wp.constant(0.5)
"""Specularity of geoms without a material, as in MuJoCo; the materials of this scene have 1."""
NEAREST_DEPTH = wp.constant(0.01)
"""A shape nearer to the camera's plane than this [m] is binned into every tile."""
SPREAD = wp.constant(0.02)
"""Angular radius of the light [rad]."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


Row = wp.types.vector(TILE, wp.float32)
Indices = wp.types.vector(TILE, wp.int32)


@wp.struct
class CameraIntrinsics:
    """Pinhole camera.

    Attributes:
        camera: id in the model; ``size``: side of the square image [px]; ``focal``: focal length
            [px].
        tiles_across: tiles in a row of the image.
    """

    camera: int
    size: int
    focal: float
    tiles_across: int


@wp.func
def slope(intrinsics: CameraIntrinsics, at: float) -> float:
    """Return the slope, to the right or downwards, of the ray at a distance [px] from the image's
    edge.
    """
    return (at - 0.5 * float(intrinsics.size)) / intrinsics.focal


@wp.func
def ray_of(from_camera: wp.mat33, x: float, y: float) -> wp.vec3:
    """Return the direction (x, y, -1) of the camera's frame, turned into another frame."""
    return wp.vec3(
        from_camera[0, 0] * x + from_camera[0, 1] * y - from_camera[0, 2],
        from_camera[1, 0] * x + from_camera[1, 1] * y - from_camera[1, 2],
        from_camera[2, 0] * x + from_camera[2, 1] * y - from_camera[2, 2],
    )


@wp.struct
class Shape:
    """A geom of one world, ready for rays from the camera; vectors are in the geom's own frame.

    Attributes:
        geom_type: ``mujoco.mjtGeom``.
        size: half-sizes [m], as MuJoCo has them.
        color_rgb: color, 0 to 1.
        camera: position of the camera [m].
        from_camera: rotation from the camera's axes.
        to_light: unit vector towards the directional light.
        up: unit vector upwards.
        texture: index, -1 for none.
        repeat: how often the texture repeats along u and v.
        repeats_per_m: how often it repeats along a meter of the surface, where that is most.
        alpha: opacity, 0 to 1.
        specularity: share of the light's specular color that it reflects.
        bounds: in the image: least and greatest column, then row [px]; inverted if it is not
            visible.
        low, high: corners of a box around it, light frame [m]; inverted if it casts no shadow.
    """

    geom_type: int
    size: wp.vec3
    color_rgb: wp.vec3
    camera: wp.vec3
    from_camera: wp.mat33
    to_light: wp.vec3
    up: wp.vec3
    texture: int
    repeat: wp.vec2
    repeats_per_m: float
    alpha: float
    specularity: float
    bounds: wp.vec4
    low: wp.vec3
    high: wp.vec3


@wp.struct
class Worlds:
    """What there is in each world of a batch, in which tiles of its image, and what its pixels
    show.

    Attributes:
        shapes: (N, S) shapes.
        lists, counts: (N, tiles, S) shapes that a tile may show, and (N, tiles) how many.
        casters, caster_counts: shapes that may shade what a tile shows, likewise.
        visible, depths: (N, H, tiles across) index of the shape that each pixel shows, -1 for none,
            and depth [m].
        colors: (N, H, tiles across) 0xBBGGRR from the middle of each pixel.
        images: (N, H, W, 3) RGB.
        cam_xpos, cam_xmat: (N, cameras) poses, world.
        light_xdir: (N, lights) directions in which light travels, world; of all lights the first
            counts.
        diffuse, specular: (N, lights) their colors.
        light_camera: (N,) position of the camera [m] in the light frame, whose z axis points
            towards the light.
        light_from_camera: (N,) rotations from the camera's axes to it.
    """

    shapes: wp.array2d[Shape]
    lists: wp.array3d[int]
    counts: wp.array2d[int]
    casters: wp.array3d[int]
    caster_counts: wp.array2d[int]
    visible: wp.array3d[Indices]
    depths: wp.array3d[Row]
    colors: wp.array3d[Indices]
    images: wp.array4d[wp.uint8]
    cam_xpos: wp.array2d[wp.vec3]
    cam_xmat: wp.array2d[wp.mat33]
    light_xdir: wp.array2d[wp.vec3]
    diffuse: wp.array2d[wp.vec3]
    specular: wp.array2d[wp.vec3]
    light_camera: wp.array[wp.vec3]
    light_from_camera: wp.array[wp.mat33]


def worlds_of(fields: Mapping[str, wp.array], intrinsics: Any, shapes: int) -> Any:
    """Return ``Worlds`` of per-world fields of N rows, by name, on warp's current device; nothing
    is placed yet.
    """
    worlds = Worlds()
    nsim = fields["geom_xpos"].shape[0]
    worlds.cam_xpos, worlds.cam_xmat, worlds.light_xdir = (
        fields[n] for n in ("cam_xpos", "cam_xmat", "light_xdir")
    )
    worlds.diffuse = fields["light_diffuse"]
    worlds.specular = fields["light_specular"]
    worlds.shapes = wp.empty((nsim, shapes), dtype=Shape)
    tiles = (nsim, intrinsics.tiles_across**2)
    rows = (nsim, intrinsics.size, intrinsics.tiles_across)
    worlds.lists = wp.empty((*tiles, shapes), dtype=int)
    worlds.casters = wp.empty((*tiles, shapes), dtype=int)
    worlds.counts = wp.empty(tiles, dtype=int)
    worlds.caster_counts = wp.zeros(tiles, dtype=int)
    worlds.visible = wp.empty(rows, dtype=Indices)
    worlds.depths = wp.empty(rows, dtype=Row)
    worlds.colors = wp.empty(rows, dtype=Indices)
    worlds.images = wp.empty((nsim, intrinsics.size, intrinsics.size, 3), dtype=wp.uint8)
    worlds.light_camera = wp.empty(nsim, dtype=wp.vec3)
    worlds.light_from_camera = wp.empty(nsim, dtype=wp.mat33)
    return worlds


@wp.kernel
def place_shapes(
    intrinsics: CameraIntrinsics,
    shown: wp.array[int],
    casts: wp.array[int],
    geom_types: wp.array[int],
    texture_of: wp.array[int],
    repeat_of: wp.array[wp.vec2],
    geom_size: wp.array2d[wp.vec3],
    geom_rgba: wp.array2d[wp.vec4],
    geom_matid: wp.array2d[int],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    worlds: Worlds,
):
    """Write one shape, and with the first the light frame. Launched over (worlds, shapes)."""
    w, s = wp.tid()
    to_light_frame = _to_light_frame(worlds.light_xdir[w, 0])
    if s == 0:
        worlds.light_camera[w] = to_light_frame * worlds.cam_xpos[w, intrinsics.camera]
        worlds.light_from_camera[w] = to_light_frame * worlds.cam_xmat[w, intrinsics.camera]
    geom = shown[s]
    to_shape = wp.transpose(geom_xmat[w, geom])
    rgba = geom_rgba[w, geom]
    shape = Shape()
    shape.geom_type = geom_types[s]
    shape.size = geom_size[w, geom]
    shape.color_rgb = wp.vec3(rgba[0], rgba[1], rgba[2])
    shape.camera = to_shape * (worlds.cam_xpos[w, intrinsics.camera] - geom_xpos[w, geom])
    shape.from_camera = to_shape * worlds.cam_xmat[w, intrinsics.camera]
    shape.to_light = -(to_shape * worlds.light_xdir[w, 0])
    shape.up = to_shape * wp.vec3(0.0, 0.0, 1.0)
    shape.alpha = rgba[3]
    shape.specularity = PLAIN_SPECULARITY
    shape.texture = -1
    if geom_matid[w, geom] >= 0:
        shape.specularity = 1.0
        shape.texture = texture_of[geom_matid[w, geom]]
        shape.repeat = repeat_of[geom_matid[w, geom]]
        shape.repeats_per_m = (
            0.5 * wp.max(shape.repeat) / textured_half_size(shape.geom_type, shape.size)
        )
    shape.bounds = wp.vec4(FAR, -FAR, FAR, -FAR)
    shape.low = wp.vec3(FAR)
    shape.high = wp.vec3(-FAR)
    if rgba[3] > 0.0:
        shape.bounds = _bounds(intrinsics, shape)
        if casts[s] == 1:
            center = to_light_frame * geom_xpos[w, geom]
            reach = _reach(to_light_frame * geom_xmat[w, geom], _half_extents(shape))
            shape.low = center - reach
            shape.high = center + reach
    worlds.shapes[w, s] = shape


@wp.func
def _bounds(intrinsics: CameraIntrinsics, shape: Shape) -> wp.vec4:
    """Bounds of a shape in the image [px]; generous for ellipsoids and cylinders."""
    to_camera = wp.transpose(shape.from_camera)
    center = -(to_camera * shape.camera)
    if shape.geom_type == PLANE:
        return wp.vec4(-FAR, FAR, -FAR, FAR)
    if center[2] > _reach(to_camera, _half_extents(shape))[2]:
        return wp.vec4(FAR, -FAR, FAR, -FAR)  # behind the camera
    if shape.geom_type == BOX:
        return _box_bounds(intrinsics, center, to_camera, shape.size)
    if shape.geom_type == SPHERE:
        return _sphere_bounds(intrinsics, center, shape.size[0])
    if shape.geom_type == ELLIPSOID:
        return _sphere_bounds(intrinsics, center, wp.max(shape.size))
    end = to_camera * wp.vec3(0.0, 0.0, shape.size[1])
    return _bounds_of_both(
        _sphere_bounds(intrinsics, center - end, shape.size[0]),
        _sphere_bounds(intrinsics, center + end, shape.size[0]),
    )


@wp.func
def _box_bounds(
    intrinsics: CameraIntrinsics, center: wp.vec3, to_camera: wp.mat33, size: wp.vec3
) -> wp.vec4:
    bounds = wp.vec4(FAR, -FAR, FAR, -FAR)
    for corner in range(8):
        x = size[0] * (2.0 * float(corner & 1) - 1.0)
        y = size[1] * (float(corner & 2) - 1.0)
        z = size[2] * (0.5 * float(corner & 4) - 1.0)
        bounds = _bounds_of_both(
            bounds, _sphere_bounds(intrinsics, center + to_camera * wp.vec3(x, y, z), 0.0)
        )
    return bounds


@wp.func
def _sphere_bounds(intrinsics: CameraIntrinsics, center: wp.vec3, radius: float) -> wp.vec4:
    depth = -center[2]
    if depth - radius < NEAREST_DEPTH:
        return wp.vec4(-FAR, FAR, -FAR, FAR)
    x = _span(center[0], depth, radius)
    y = _span(-center[1], depth, radius)
    half = 0.5 * float(intrinsics.size)
    return wp.vec4(x[0], x[1], y[0], y[1]) * intrinsics.focal + wp.vec4(half, half, half, half)


@wp.func
def _span(aside: float, depth: float, radius: float) -> wp.vec2:
    """Slopes of the two tangents from the camera to a circle."""
    room = depth * depth - radius * radius
    root = radius * wp.sqrt(room + aside * aside)
    return wp.vec2(aside * depth - root, aside * depth + root) / room


@wp.func
def _bounds_of_both(a: wp.vec4, b: wp.vec4) -> wp.vec4:
    return wp.vec4(wp.min(a[0], b[0]), wp.max(a[1], b[1]), wp.min(a[2], b[2]), wp.max(a[3], b[3]))


@wp.kernel
def sort_into_tiles(intrinsics: CameraIntrinsics, room: wp.array[int], worlds: Worlds):
    """List the shapes whose bounds overlap a tile, in the order of the geoms. Launched over
    (worlds, tiles).

    Floor and walls, of the numbers in ``room``, extend beyond the image, but most tiles show only
    one of them.
    """
    w, tile = wp.tid()
    left = float((tile % intrinsics.tiles_across) * TILE)
    top = float((tile // intrinsics.tiles_across) * TILE)
    count = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
    for s in range(worlds.shapes.shape[1]):
        o = worlds.shapes[w, s].bounds
        if o[0] < left + float(TILE) and o[1] > left and o[2] < top + float(TILE) and o[3] > top:
            hidden = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
            for k in range(room.shape[0]):
                if room[k] == s:
                    hidden = _hidden_by_room(intrinsics, room, worlds.shapes, w, s, left, top)
            if hidden == 0:
                worlds.lists[w, tile, count] = s
                count += 1
    worlds.counts[w, tile] = count


@wp.func
def _hidden_by_room(
    intrinsics: CameraIntrinsics,
    room: wp.array[int],
    shapes: wp.array2d[Shape],
    w: int,
    s: int,
    left: float,
    top: float,
) -> int:
    """1 if at all corners of a tile one other side of the room is nearer than side ``s``.

    The camera is inside the room, so where one plane hides another is a half-plane of the image: if
    it holds the corners, it holds the tile.
    """
    own = _corner_depths(intrinsics, shapes[w, s], left, top)
    for k in range(room.shape[0]):
        if room[k] != s:
            other = _corner_depths(intrinsics, shapes[w, room[k]], left, top)
            if other[0] < own[0] and other[1] < own[1] and other[2] < own[2] and other[3] < own[3]:
                return 1
    return 0


@wp.func
def _corner_depths(intrinsics: CameraIntrinsics, shape: Shape, left: float, top: float) -> wp.vec4:
    """Depths [m] of one side of the room at the corners of a tile, far where it is not seen."""
    depths = wp.vec4()
    for corner in range(4):
        x = slope(intrinsics, left + float(TILE * (corner & 1)))
        y = -slope(intrinsics, top + float(TILE * (corner >> 1)))
        ray = shape.from_camera * wp.vec3(x, y, -1.0)
        depth = enter_plane(shape.size, shape.camera, ray)
        if shape.geom_type == BOX:
            depth = enter_box(shape.size, shape.camera, ray)
        depths[corner] = wp.where(depth > 0.0, depth, FAR)
    return depths


@wp.kernel
def sort_casters(intrinsics: CameraIntrinsics, worlds: Worlds):
    """List the shapes that may shade something that a tile shows. Launched over (worlds, tiles).

    What a tile shows lies in the part of its pyramid between its least and its greatest depth.
    """
    w, tile = wp.tid()
    column = tile % intrinsics.tiles_across
    left = column * TILE
    top = (tile // intrinsics.tiles_across) * TILE
    nearest = Row(FAR)
    farthest = Row(0.0)
    for row in range(top, wp.min(top + TILE, intrinsics.size)):
        depth = worlds.depths[w, row, column]
        for i in range(TILE):
            nearest[i] = wp.min(nearest[i], depth[i])
            farthest[i] = wp.max(farthest[i], wp.where(depth[i] < FAR, depth[i], 0.0))
    near = wp.min(nearest)
    far = wp.max(farthest)
    worlds.caster_counts[w, tile] = 0
    if far > 0.0:
        low = wp.vec3(FAR)
        high = wp.vec3(-FAR)
        for corner in range(8):
            x = slope(intrinsics, float(left + TILE * (corner & 1)))
            y = -slope(intrinsics, float(top + TILE * ((corner >> 1) & 1)))
            ray = ray_of(worlds.light_from_camera[w], x, y)
            point = worlds.light_camera[w] + wp.where(corner < 4, near, far) * ray
            low = wp.min(low, point)
            high = wp.max(high, point)
        count = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for s in range(worlds.shapes.shape[1]):
            if may_shade(worlds.shapes[w, s].low, worlds.shapes[w, s].high, low, high):
                worlds.casters[w, tile, count] = s
                count += 1
        worlds.caster_counts[w, tile] = count


@wp.func
def may_shade(caster_low: wp.vec3, caster_high: wp.vec3, low: wp.vec3, high: wp.vec3) -> bool:
    """Return whether something in one box may shade something in another; corners [m], light
    frame.
    """
    edge = SPREAD * wp.max(caster_high[2] - low[2], 0.0)
    beside = caster_low[0] - edge > high[0] or caster_high[0] + edge < low[0]
    beside = beside or caster_low[1] - edge > high[1] or caster_high[1] + edge < low[1]
    return caster_high[2] > low[2] and not beside


@wp.func
def _to_light_frame(direction: wp.vec3) -> wp.mat33:
    """Rotation from the world to a frame whose z axis points towards the light."""
    z = -wp.normalize(direction)
    x = wp.normalize(wp.cross(wp.vec3(0.0, 1.0, 0.1), z))
    y = wp.cross(z, x)
    return wp.mat33(x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2])


@wp.func
def _half_extents(shape: Shape) -> wp.vec3:
    if shape.geom_type == BOX or shape.geom_type == ELLIPSOID:  # noqa: PLR1714 - warp has no sets
        return shape.size
    if shape.geom_type == CAPSULE:
        return wp.vec3(shape.size[0], shape.size[0], shape.size[0] + shape.size[1])
    if shape.geom_type == CYLINDER:
        return wp.vec3(shape.size[0], shape.size[0], shape.size[1])
    return wp.vec3(shape.size[0])


@wp.func
def _reach(turned: wp.mat33, half: wp.vec3) -> wp.vec3:
    """How far a turned box of these half extents reaches along each axis."""
    return wp.vec3(
        wp.abs(turned[0, 0]) * half[0]
        + wp.abs(turned[0, 1]) * half[1]
        + wp.abs(turned[0, 2]) * half[2],
        wp.abs(turned[1, 0]) * half[0]
        + wp.abs(turned[1, 1]) * half[1]
        + wp.abs(turned[1, 2]) * half[2],
        wp.abs(turned[2, 0]) * half[0]
        + wp.abs(turned[2, 1]) * half[1]
        + wp.abs(turned[2, 2]) * half[2],
    )
