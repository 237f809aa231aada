"""Appearance: procedural textures in the scene, and the choice of textures, colours and light of an episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

TEXTURE_SIZE = 64
SKIN_TONES = np.array(
    [[0.95, 0.80, 0.69], [0.87, 0.68, 0.55], [0.72, 0.52, 0.39], [0.52, 0.36, 0.27], [0.36, 0.25, 0.2]]
)
Pattern = Callable[[np.ndarray, np.ndarray], np.ndarray]

_noise = np.random.default_rng(20260)
_GRAIN = _noise.random((TEXTURE_SIZE, TEXTURE_SIZE))
_CLOUD = np.kron(_noise.random((8, 8)), np.ones((8, 8)))


def _wave(phase: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * np.sin(2 * np.pi * phase)


PATTERNS: dict[str, Pattern] = {
    "plain": lambda u, v: np.ones_like(u),
    "checker": lambda u, v: (np.floor(4 * u) + np.floor(4 * v)) % 2,
    "stripes": lambda u, v: np.floor(6 * u) % 2,
    "bands": lambda u, v: np.floor(5 * v) % 2,
    "dots": lambda u, v: (np.hypot((4 * u) % 1 - 0.5, (4 * v) % 1 - 0.5) > 0.3).astype(float),
    "wood": lambda u, v: _wave(6 * u + 0.35 * _wave(2 * v)),
    "grain": lambda u, v: _GRAIN,
    "cloud": lambda u, v: _CLOUD,
    "rings": lambda u, v: _wave(4 * np.hypot(u - 0.5, v - 0.5)),
    "weave": lambda u, v: 0.5 * _wave(8 * u) + 0.5 * _wave(8 * v),
}
"""Brightness, 0 to 1, over the unit square (u, v), (H, W) each; multiplied by a colour of the episode."""

CONTRAST = 0.45
"""Share of the colour that the dark parts of a pattern take away."""


def texture_pixels(pattern: str) -> np.ndarray:
    """Return (64, 64, 3) uint8 grey pixels of a pattern, to be multiplied by a tint."""
    v, u = np.meshgrid(*[(np.arange(TEXTURE_SIZE) + 0.5) / TEXTURE_SIZE] * 2, indexing="ij")
    grey = 1.0 - CONTRAST * (1.0 - PATTERNS[pattern](u, v))
    return np.repeat(np.round(255 * grey)[..., None], 3, axis=2).astype(np.uint8)


@dataclass(frozen=True)
class Distractor:
    """A solid that is shown and collides with nothing.

    Attributes:
        shape: one of ``scene.DISTRACTORS``.
        half_size: (3,) MuJoCo half-sizes [m].
        pos_w: (3,) centre [m], world.
        rgb: (3,) colour, 0 to 1.
    """

    shape: str
    half_size: tuple[float, ...]
    pos_w: tuple[float, float, float]
    rgb: tuple[float, float, float]


@dataclass(frozen=True)
class Appearance:
    """Textures, colours and light of one episode.

    Attributes:
        target_pattern, floor_pattern, wall_pattern, box_pattern: names in ``PATTERNS``.
        target_rgb, floor_rgb, wall_rgb, box_rgb, skin_rgb: tints, 0 to 1.
        light_dir: (3,) direction the light travels in, world.
        light_level: diffuse intensity of the light, 0 to 1.
        light_rgb: its colour, 0 to 1.
        gloss: intensity of the highlights, 0 to 1.
        target_alpha: opacity of the target, 0 to 1.
        distractors: further solids in view, each of another shape.
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
    distractors: tuple[Distractor, ...] = ()

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Appearance:
        """Draw patterns, colours and light: a saturated target in front of paler surroundings."""
        patterns = rng.choice(list(PATTERNS), size=4)
        hue = rng.random()
        slant = rng.uniform(-0.6, 0.6, 2)
        return cls(
            *(str(p) for p in patterns),
            target_rgb=hsv(hue, rng.uniform(0.7, 1.0), rng.uniform(0.75, 1.0)),
            floor_rgb=hsv(rng.random(), rng.uniform(0.0, 0.3), rng.uniform(0.35, 0.8)),
            wall_rgb=hsv(rng.random(), rng.uniform(0.0, 0.3), rng.uniform(0.45, 0.9)),
            box_rgb=hsv((hue + rng.uniform(0.3, 0.7)) % 1.0, rng.uniform(0.1, 0.4), rng.uniform(0.4, 0.8)),
            skin_rgb=_rgb(SKIN_TONES[rng.integers(len(SKIN_TONES))]),
            light_dir=(0.6 + float(slant[0]) * 0.5, float(slant[1]), -1.0),
            light_level=rng.uniform(0.45, 0.8),
        )


def _rgb(values: np.ndarray) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def hsv(hue: float, saturation: float, value: float) -> tuple[float, float, float]:
    """Hue, saturation and value, each 0 to 1, to red, green and blue."""
    k = (np.array([5.0, 3.0, 1.0]) + 6 * hue) % 6
    return _rgb(value - value * saturation * np.clip(np.minimum(k, 4 - k), 0, 1))
