"""Textures at several sharpnesses, so that what is far away neither flickers nor shows moire
(Williams, 1983).

Levels shrink by the square root of two, so that the nearest one can be taken and no seam shows
between them.
"""

# ruff: noqa: PLR0917 - warp functions take their arguments by position

import functools
from typing import Any

import mujoco
import numpy as np
import warp as wp

LEVELS_PER_OCTAVE = 2
SMALLEST = 4
"""Side of the least sharp level [texels]."""
ROUNDING = 4096
"""Brightness is rounded to such a part, as the order of a sum may differ between machines."""

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "max_unroll": 1})


@wp.struct
class Textures:
    """Gray square textures of one size.

    Attributes:
        texels: (K * M,) brightness, 0 to 1: texture after texture, level after level, row by row.
        texels_each: M.
        starts: (L,) where each level of a texture begins.
        sides: (L,) side of each level [texels].
        limits: (L - 1,) texels of the sharpest level in a pixel from which on each next level is
            taken.
        filtered: 1 to sample the level that fits a pixel, 0 for the sharpest always.
    """

    texels: wp.array[float]
    texels_each: int
    starts: wp.array[int]
    sides: wp.array[int]
    limits: wp.array[float]
    filtered: int


@wp.func
def level_of(textures: Textures, repeats_per_pixel: float, facing: float) -> int:
    """Return the level whose texels are about as large as a pixel.

    A pixel that sees a surface aslant covers more of it in one direction; the level follows from
    the mean of both.

    Args:
        textures: of the scene.
        repeats_per_pixel: how often the texture repeats across a pixel that faces it.
        facing: cosine between the surface's normal and the ray.
    """
    if textures.filtered == 0:
        return 0
    texels = repeats_per_pixel * float(textures.sides[0]) / wp.sqrt(wp.max(facing, 0.02))
    level = int(0)  # noqa: RUF046, UP018 - warp's way to say that it varies
    for k in range(textures.limits.shape[0]):
        level += wp.where(texels > textures.limits[k], 1, 0)
    return level


@wp.func
def texel(texels: wp.array[float], start: int, side: int, wrap: int, u: float, v: float) -> float:
    """Return the bilinear interpolation between a texture's four nearest texels.

    Args:
        texels: of all textures.
        start: where the level begins in them; ``side``: its side.
        wrap: 1 if the last texel is followed by the first, 0 if by itself, as in mujoco_warp.
        u, v: texture coordinates, 0 to 1.
    """
    x = u * float(side) - 0.5
    y = v * float(side) - 0.5
    x0 = wp.floor(x)
    y0 = wp.floor(y)
    left = int(x0)
    up = int(y0)
    right = left + 1
    down = up + 1
    first = (1 - wrap) * (side - 1)
    last = wrap * (side - 1)
    right = wp.where(right < side, right, first)
    down = wp.where(down < side, down, first)
    left = wp.where(left < 0, last, left)
    up = wp.where(up < 0, last, up)
    upper = start + side * up
    lower = start + side * down
    above = wp.lerp(texels[upper + left], texels[upper + right], x - x0)
    below = wp.lerp(texels[lower + left], texels[lower + right], x - x0)
    return wp.lerp(above, below, y - y0)


@functools.cache  # every shard of a dataset has a renderer of its own
def textures_of(model: mujoco.MjModel, *, filtered: bool) -> Any:
    """Return the ``Textures`` of a model, whose textures must be square, gray and of one size, on
    warp's device.
    """
    side = int(model.tex_width[0])
    sharpest = (
        model.tex_data.reshape(model.ntex, side, side, 3)[..., 0].astype(np.float32) / 255
    )  # (K, S, S)
    sides = level_sides(side)
    levels = [shrink(sharpest, smaller).reshape(model.ntex, -1) for smaller in sides]
    textures = Textures()
    texels = np.concatenate(levels, axis=1)  # (K, M)
    textures.texels = wp.array(texels.ravel(), dtype=float)
    textures.texels_each = texels.shape[1]
    textures.starts = wp.array(np.cumsum([0, *[one.shape[1] for one in levels]])[:-1], dtype=int)
    limits = 2 ** ((np.arange(1, len(sides)) - 0.5) / LEVELS_PER_OCTAVE)
    textures.limits = wp.array(limits.astype(np.float32), dtype=float)
    textures.sides = wp.array(sides, dtype=int)
    textures.filtered = int(filtered)
    return textures


def level_sides(side: int) -> list[int]:
    """Return the side of each level [texels], sharpest first, of a texture of ``side`` texels."""
    octaves = np.arange(0, np.log2(side / SMALLEST) + 1e-6, 1 / LEVELS_PER_OCTAVE)
    return np.round(side / 2**octaves).astype(int).tolist()


def shrink(textures: np.ndarray, side: int) -> np.ndarray:
    """Return textures (K, S, S) averaged down to (K, side, side): each texel is the mean of the
    area it covers.
    """
    across = _interval_means(textures, side).swapaxes(1, 2)
    means = _interval_means(across, side).swapaxes(1, 2)
    return (np.round(means * ROUNDING) / ROUNDING).astype(np.float32)


def _interval_means(rows: np.ndarray, few: int) -> np.ndarray:
    """(..., few) means over so many equal intervals of rows (..., S)."""
    many = rows.shape[-1]
    sums = np.zeros((*rows.shape[:-1], many + 2))  # of the values before each; the last is not used
    np.cumsum(rows, axis=-1, dtype=float, out=sums[..., 1:-1])
    edges = np.linspace(0.0, many, few + 1)
    before = np.floor(edges).astype(int)
    up_to = sums[..., before] + (edges - before) * (sums[..., before + 1] - sums[..., before])
    return np.diff(up_to, axis=-1) * (few / many)
