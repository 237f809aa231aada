"""Procedural patterns that surfaces may have: grey, seamless where they repeat, multiplied by a colour."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

TEXTURE_SIZE = 128
Pattern = Callable[[np.ndarray, np.ndarray], np.ndarray]

_random = np.random.default_rng(20260)
_GRAIN, _CLOUD, _TONES = _random.random((64, 64)), _random.random((6, 6)), _random.random(64)


def _wave(phase: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * np.sin(2 * np.pi * phase)


def _noise(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Smooth noise: a periodic grid of values (K, K), interpolated at (u, v)."""
    n = len(values)
    x, y = u * n, v * n
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = x - i, y - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    upper = (1 - a) * values[j % n, i % n] + a * values[j % n, (i + 1) % n]
    lower = (1 - a) * values[(j + 1) % n, i % n] + a * values[(j + 1) % n, (i + 1) % n]
    return (1 - b) * upper + b * lower


def _rectangles(u: np.ndarray, v: np.ndarray, across: int, down: int, shift: float) -> np.ndarray:
    """Rows of rectangles of slightly different tones with dark joints; every second row is shifted."""
    row = np.floor(v * down)
    x = u * across + shift * (row % 2)
    tone = _TONES[(7 * row + 3 * (np.floor(x) % across)).astype(int) % len(_TONES)]
    joint = np.minimum(np.abs((x + 0.5) % 1 - 0.5) / across, np.abs((v * down + 0.5) % 1 - 0.5) / down)
    return np.where(joint < 0.008, 0.0, 0.55 + 0.45 * tone)


def _planks(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return _rectangles(u, v, 1, 6, 0.45) * (0.8 + 0.2 * _noise(_GRAIN, 0.125 * np.floor(8 * v) + v, 0.25 * u))


PATTERNS: dict[str, Pattern] = {
    "plain": lambda u, v: np.ones_like(u),
    "checker": lambda u, v: (np.floor(4 * u) + np.floor(4 * v)) % 2,
    "stripes": lambda u, v: np.clip(4 * _wave(5 * u) - 1.5, 0, 1),
    "bands": lambda u, v: np.clip(4 * _wave(4 * v) - 1.5, 0, 1),
    "dots": lambda u, v: np.clip(20 * (np.hypot((4 * u) % 1 - 0.5, (4 * v) % 1 - 0.5) - 0.25), 0, 1),
    "wood": lambda u, v: 0.6 * _wave(6 * v + 0.35 * _wave(2 * u)) + 0.4 * _noise(_GRAIN, u, v),
    "grain": lambda u, v: _noise(_GRAIN, u, v),
    "cloud": lambda u, v: 0.7 * _noise(_CLOUD, u, v) + 0.3 * _noise(_GRAIN, u, v),
    "rings": lambda u, v: _wave(4 * np.hypot(u - 0.5, v - 0.5)),
    "weave": lambda u, v: 0.5 * _wave(8 * u) + 0.5 * _wave(8 * v),
    "planks": _planks,
    "tiles": lambda u, v: _rectangles(u, v, 3, 3, 0.0),
    "bricks": lambda u, v: _rectangles(u, v, 4, 8, 0.5),
}
"""Brightness, 0 to 1, over the unit square (u, v), (H, W) each; multiplied by a colour of the episode."""


def texture_pixels(pattern: str, contrast: float) -> np.ndarray:
    """Return (128, 128, 3) uint8 grey pixels of a pattern; its darkest parts lack a share ``contrast``."""
    v, u = np.meshgrid(*[(np.arange(TEXTURE_SIZE) + 0.5) / TEXTURE_SIZE] * 2, indexing="ij")
    grey = 1.0 - contrast * (1.0 - PATTERNS[pattern](u, v))
    return np.repeat(np.round(255 * grey)[..., None], 3, axis=2).astype(np.uint8)
