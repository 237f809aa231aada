"""Appearance of an episode: procedural patterns, colors, light and furniture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from dynahoi_lerobot.core.numerics import norm, sin

TEXTURE_SIZE = 128

_random = np.random.default_rng(20260)
_GRAIN = _random.random((64, 64))
_CLOUD = _random.random((6, 6))
_TONES = _random.random(64)


def _wave(phase: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * sin(2 * np.pi * phase)


def _noise(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Smooth noise: a periodic grid of values (K, K), interpolated at (u, v)."""
    n = len(values)
    x = u * n
    y = v * n
    i = np.floor(x).astype(int)
    j = np.floor(y).astype(int)
    a = x - i
    b = y - j
    a = a * a * (3 - 2 * a)
    b = b * b * (3 - 2 * b)
    upper = (1 - a) * values[j % n, i % n] + a * values[j % n, (i + 1) % n]
    lower = (1 - a) * values[(j + 1) % n, i % n] + a * values[(j + 1) % n, (i + 1) % n]
    return (1 - b) * upper + b * lower


def _rectangles(u: np.ndarray, v: np.ndarray, across: int, down: int, shift: float) -> np.ndarray:
    """Rows of rectangles of slightly different tones with dark joints; every second row is
    shifted.
    """
    row = np.floor(v * down)
    x = u * across + shift * (row % 2)
    tone = _TONES[(7 * row + 3 * (np.floor(x) % across)).astype(int) % len(_TONES)]
    joint = np.minimum(
        np.abs((x + 0.5) % 1 - 0.5) / across, np.abs((v * down + 0.5) % 1 - 0.5) / down
    )
    return np.where(joint < 0.008, 0.0, 0.55 + 0.45 * tone)


def _planks(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return _rectangles(u, v, 1, 6, 0.45) * (
        0.8 + 0.2 * _noise(_GRAIN, 0.125 * np.floor(8 * v) + v, 0.25 * u)
    )


PATTERNS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "plain": lambda u, v: np.ones_like(u),
    "checker": lambda u, v: (np.floor(4 * u) + np.floor(4 * v)) % 2,
    "stripes": lambda u, v: np.clip(4 * _wave(5 * u) - 1.5, 0, 1),
    "bands": lambda u, v: np.clip(4 * _wave(4 * v) - 1.5, 0, 1),
    "dots": lambda u, v: np.clip(
        20 * (np.hypot((4 * u) % 1 - 0.5, (4 * v) % 1 - 0.5) - 0.25), 0, 1
    ),
    "wood": lambda u, v: 0.6 * _wave(6 * v + 0.35 * _wave(2 * u)) + 0.4 * _noise(_GRAIN, u, v),
    "grain": lambda u, v: _noise(_GRAIN, u, v),
    "cloud": lambda u, v: 0.7 * _noise(_CLOUD, u, v) + 0.3 * _noise(_GRAIN, u, v),
    "rings": lambda u, v: _wave(4 * np.hypot(u - 0.5, v - 0.5)),
    "weave": lambda u, v: 0.5 * _wave(8 * u) + 0.5 * _wave(8 * v),
    "planks": _planks,
    "tiles": lambda u, v: _rectangles(u, v, 3, 3, 0.0),
    "bricks": lambda u, v: _rectangles(u, v, 4, 8, 0.5),
}
"""Brightness, 0 to 1, of u (1, W) and v (H, 1) in the unit square, to be broadcast; multiplied by a
color."""


def texture_pixels(pattern: str, contrast: float) -> np.ndarray:
    """Return (128, 128, 3) uint8 gray pixels of a pattern; its darkest parts lack a share
    ``contrast``.
    """
    across = (np.arange(TEXTURE_SIZE) + 0.5) / TEXTURE_SIZE
    gray = 1.0 - contrast * (1.0 - PATTERNS[pattern](across[None], across[:, None]))
    pixels = np.round(255 * gray)[..., None].astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(pixels, (TEXTURE_SIZE, TEXTURE_SIZE, 3)))


SKIN_TONES = np.array(
    [
        [0.95, 0.80, 0.69],
        [0.87, 0.68, 0.55],
        [0.72, 0.52, 0.39],
        [0.52, 0.36, 0.27],
        [0.36, 0.25, 0.2],
    ]
)
MOST_SATURATED_FLOOR = 0.5
MOST_SATURATED_WALL = 0.4
LEAST_CONTRAST = 0.25
"""Least distance in RGB, 0 to 1 each, between a target and the surfaces behind it."""


@dataclass(frozen=True)
class Solid:
    """A visible solid without collisions.

    Attributes:
        shape: one of ``model.SHAPES``.
        half_size: (3,) MuJoCo half-sizes [m].
        pos_w: (3,) center [m], world.
        rgb: (3,) color, 0 to 1.
    """

    shape: str
    half_size: tuple[float, ...]
    pos_w: tuple[float, float, float]
    rgb: tuple[float, float, float]


@dataclass(frozen=True)
class Appearance:
    """Textures, colors and light of one episode.

    Attributes:
        target_pattern, floor_pattern, wall_pattern, box_pattern: names in ``PATTERNS``.
        target_rgb, floor_rgb, wall_rgb, box_rgb, skin_rgb: tints, 0 to 1.
        light_dir: (3,) direction the light travels in, world.
        light_level: diffuse intensity of the light, 0 to 1.
        light_rgb: its color, 0 to 1.
        gloss: intensity of the highlights, 0 to 1.
        target_alpha: opacity of the target, 0 to 1.
        distractors: further solids in view, each of another shape.
        furniture: boxes that stand about.
        sleeve_rgb: color of the sleeve, 0 to 1.
        screen: the panel that hides the target for a while, under a protocol that has one.
    """

    target_pattern: str
    floor_pattern: str
    wall_pattern: str
    box_pattern: str
    target_rgb: tuple[float, float, float]
    floor_rgb: tuple[float, float, float]
    wall_rgb: tuple[float, float, float]
    box_rgb: tuple[float, float, float]
    skin_rgb: tuple[float, float, float]
    light_dir: tuple[float, float, float]
    light_level: float
    light_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gloss: float = 0.0
    target_alpha: float = 1.0
    distractors: tuple[Solid, ...] = ()
    furniture: tuple[Solid, ...] = ()
    sleeve_rgb: tuple[float, float, float] = (0.3, 0.32, 0.38)
    screen: Solid | None = None

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Self:
        """Draw patterns, colors and light; hues and saturations of target and surroundings
        overlap.
        """
        patterns = rng.choice(list(PATTERNS), size=4)
        hue = rng.random()
        slant = rng.uniform(-0.6, 0.6, 2)
        target_rgb = hsv(hue, rng.uniform(0.3, 1.0), rng.uniform(0.4, 1.0))
        floor_rgb = hsv(
            _warm(rng.random()), MOST_SATURATED_FLOOR * rng.random(), rng.uniform(0.3, 0.8)
        )
        wall_rgb = hsv(
            rng.random(), MOST_SATURATED_WALL * rng.random() ** 1.5, rng.uniform(0.45, 0.9)
        )
        box_rgb = hsv(hue + rng.uniform(0.15, 0.85), rng.uniform(0.1, 0.6), rng.uniform(0.4, 0.8))
        return cls(
            *(str(p) for p in patterns),
            target_rgb=set_apart(target_rgb, [floor_rgb, wall_rgb, box_rgb]),
            floor_rgb=floor_rgb,
            wall_rgb=wall_rgb,
            box_rgb=box_rgb,
            skin_rgb=_rgb(SKIN_TONES[rng.integers(len(SKIN_TONES))]),
            light_dir=(0.6 + float(slant[0]) * 0.5, float(slant[1]), -1.0),
            light_level=rng.uniform(0.45, 0.8),
        )


def set_apart(
    rgb: tuple[float, float, float], surfaces: Sequence[tuple[float, float, float]]
) -> tuple[float, float, float]:
    """Return a color, or the nearest relative of it that is ``LEAST_CONTRAST`` away from all
    ``surfaces``.

    Relatives are lighter, darker, and in the end of the opposite hue; if none will do, the
    farthest.
    """
    color = np.asarray(rgb)
    relatives = [color, 0.6 * color + 0.4, 0.5 * color, color[[1, 2, 0]], color[[2, 0, 1]]]
    distance = [min(norm(one - np.asarray(surface)) for surface in surfaces) for one in relatives]
    fits = [one for one, far in zip(relatives, distance, strict=True) if far >= LEAST_CONTRAST]
    return _rgb(fits[0] if fits else relatives[int(np.argmax(distance))])


def _warm(turn: float) -> float:
    """Return a hue from a uniform draw, 0 to 1; half of the hues are those of wood or stone."""
    return 0.03 + 0.2 * turn if turn < 0.5 else 2.0 * turn - 1.0


def _rgb(values: np.ndarray) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def hsv(hue: float, saturation: float, value: float) -> tuple[float, float, float]:
    """Hue in turns, saturation and value, 0 to 1, to red, green and blue."""
    k = (np.array([5.0, 3.0, 1.0]) + 6 * (hue % 1.0)) % 6
    return _rgb(value - value * saturation * np.clip(np.minimum(k, 4 - k), 0, 1))
