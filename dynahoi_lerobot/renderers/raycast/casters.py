"""Which shapes may cast a shadow on what a tile shows: boxes around them in the light's frame."""

# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import warp as wp

from dynahoi_lerobot.renderers.raycast.pixel_rows import ray_of
from dynahoi_lerobot.renderers.raycast.shadows import may_shade
from dynahoi_lerobot.renderers.raycast.shapes import BOX, CAPSULE, CYLINDER, ELLIPSOID
from dynahoi_lerobot.renderers.raycast.tiling import FAR, TILE, CameraIntrinsics, Row, Shape
from dynahoi_lerobot.renderers.raycast.tracing import LightFrame

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.kernel
def place_lights(
    spread: float,
    camera: int,
    cam_xpos: wp.array2d[wp.vec3],
    cam_xmat: wp.array2d[wp.mat33],
    light_xdir: wp.array2d[wp.vec3],
    frames: wp.array[LightFrame],
):
    """Write the light frame of each world. Launched over worlds."""
    w = wp.tid()
    rotation = _to_light_frame(light_xdir[w, 0])
    frame = LightFrame()
    frame.spread = spread
    frame.camera = rotation * cam_xpos[w, camera]
    frame.from_camera = rotation * cam_xmat[w, camera]
    frames[w] = frame


@wp.kernel
def place_casters(
    shown: wp.array[int],
    casts: wp.array[int],
    shapes: wp.array2d[Shape],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    light_xdir: wp.array2d[wp.vec3],
    lows: wp.array2d[wp.vec3],
    highs: wp.array2d[wp.vec3],
):
    """Write the bounds of each shape in its world's light frame [m]; inverted if it casts none.

    Launched over (worlds, shapes).
    """
    w, s = wp.tid()
    lows[w, s] = wp.vec3(FAR)
    highs[w, s] = wp.vec3(-FAR)
    if casts[s] == 1 and shapes[w, s].alpha > 0.0:
        rotation = _to_light_frame(light_xdir[w, 0])
        center = rotation * geom_xpos[w, shown[s]]
        turned = rotation * geom_xmat[w, shown[s]]
        half = _half_extents(shapes[w, s])
        reach = wp.vec3(_reach(turned, 0, half), _reach(turned, 1, half), _reach(turned, 2, half))
        lows[w, s] = center - reach
        highs[w, s] = center + reach


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
def _reach(turned: wp.mat33, axis: int, half: wp.vec3) -> float:
    return wp.abs(turned[axis, 0]) * half[0] + wp.abs(turned[axis, 1]) * half[1] + wp.abs(turned[axis, 2]) * half[2]


@wp.kernel
def sort_casters(
    intrinsics: CameraIntrinsics,
    tiles_across: int,
    frames: wp.array[LightFrame],
    depths: wp.array3d[Row],
    lows: wp.array2d[wp.vec3],
    highs: wp.array2d[wp.vec3],
    casters: wp.array3d[int],
    counts: wp.array2d[int],
):
    """List the shapes that may shade something that a tile shows. Launched over (worlds, tiles).

    What a tile shows lies in the part of its pyramid between its least and its greatest depth.
    """
    w, tile = wp.tid()
    left, top = (tile % tiles_across) * TILE, (tile // tiles_across) * TILE
    nearest, farthest = Row(FAR), Row(0.0)
    for row in range(top, wp.min(top + TILE, intrinsics.size)):
        depth = depths[w, row, tile % tiles_across]
        for i in range(TILE):
            nearest[i] = wp.min(nearest[i], depth[i])
            farthest[i] = wp.max(farthest[i], wp.where(depth[i] < FAR, depth[i], 0.0))
    near, far = wp.min(nearest), wp.max(farthest)
    counts[w, tile] = 0
    if far > 0.0:
        low, high = wp.vec3(FAR), wp.vec3(-FAR)
        for corner in range(8):
            x = _slope(intrinsics, left + TILE * (corner & 1))
            y = -_slope(intrinsics, top + TILE * ((corner >> 1) & 1))
            point = frames[w].camera + wp.where(corner < 4, near, far) * ray_of(frames[w].from_camera, x, y)
            low, high = wp.min(low, point), wp.max(high, point)
        count = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
        for s in range(lows.shape[1]):
            if may_shade(lows[w, s], highs[w, s], low, high, frames[w].spread):
                casters[w, tile, count] = s
                count += 1
        counts[w, tile] = count


@wp.func
def _slope(intrinsics: CameraIntrinsics, pixel: int) -> float:
    """Slope in the camera's frame of the ray through the near edge of a column of pixels."""
    return (float(pixel) - 0.5 * float(intrinsics.size)) / intrinsics.focal
