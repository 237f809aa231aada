"""Which seeds a split holds, and which of them is the n-th episode of a kind."""

import math

from dynahoi_lerobot.core.conventions import SEED_LIMIT
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe

SMALL_TEST = "test_small"
"""The split that commands play unless told otherwise: the first 110 episodes of ``test``."""
REDRAW_STRIDE = math.lcm(*range(1, 25))
"""A slot whose seed fails is drawn again with ``seed + k * REDRAW_STRIDE``, k = 1, 2, ...

Recipes choose the kind of motion by the seed modulo the number of kinds; a multiple of every number
up to 24 keeps the slot's kind, so failures do not unbalance the dataset.
"""

MAX_DRAWS = 16
"""Draws per slot before the recipe is called impossible."""


def split_seeds(split: str) -> range:
    """Return the seeds of a split of fixed size, in order; kinds of motion take turns in it.

    Raises:
        ValueError: for an unknown split, or for ``train``, which has no end.
    """
    return range(
        known("evaluation split", split, {n: s.size for n, s in BENCHMARK.splits.items() if s.size})
    )


def kind_seed(recipe: Recipe, kind: str | None, number: int) -> int:
    """Return the seed of the ``number``-th episode of ``kind`` in the recipe's split, or of any
    kind if None.

    A split of fixed size wraps around: n consecutive numbers, wherever they begin, are n different
    episodes as long as the split has that many of the kind.

    Raises:
        ValueError: if the recipe has no episodes of ``kind``, or for a number that is negative or
            not below ``SEED_LIMIT``.
    """
    if not 0 <= number < SEED_LIMIT:
        raise ValueError(f"episodes are numbered 0 to {SEED_LIMIT - 1}, got {number}")
    seeds = kind_seeds(recipe, kind)
    return seeds[number % len(seeds)]


def kind_seeds(recipe: Recipe, kind: str | None) -> range:
    """Return the seeds of all episodes of ``kind`` in the recipe's split, in order, or of any kind
    if None.

    Raises:
        ValueError: if the recipe has no episodes of ``kind``.
    """
    names = recipe.motion_names
    if kind is not None and kind not in names:
        raise ValueError(
            f"split {recipe.split!r} has no episodes of motion {kind!r}; it has: {', '.join(names)}"
        )
    first, step = (0, 1) if kind is None else (names.index(kind), len(names))
    last = first + step * SEED_LIMIT if recipe.split == "train" else split_seeds(recipe.split).stop
    return range(first, last, step)
