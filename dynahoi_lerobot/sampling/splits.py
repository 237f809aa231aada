"""Splits: which seeds they hold, and which seed is the j-th episode of a kind."""

from __future__ import annotations

from dynahoi_lerobot.sampling.recipe import SPLITS, Recipe

SPLIT_SIZES = {"val": 220, "test": 1000, "ood_speed": 220, "ood_object": 220, "ood_motion": 220}
"""Evaluation splits are fixed lists of episodes; ``train`` has no end."""
SMALL_TEST = "test_small"
SMALL_TEST_SIZE = 110
EVALUATION_SPLITS = ("test", SMALL_TEST, "val", "ood_speed", "ood_object", "ood_motion")


def split_seeds(split: str) -> range:
    """Return the seeds of a fixed split, in order; kinds take turns in it.

    Raises:
        ValueError: for an unknown split, or for ``train``.
    """
    if split == SMALL_TEST:
        return range(SMALL_TEST_SIZE)
    if split not in SPLIT_SIZES:
        raise ValueError(f"unknown evaluation split {split!r}; known: {', '.join(EVALUATION_SPLITS)}")
    return range(SPLIT_SIZES[split])


def seed_stream(split: str) -> str:
    """Return the seed stream of a split: ``test_small`` shares that of ``test``."""
    if split != SMALL_TEST and split not in SPLITS:
        raise ValueError(f"unknown split {split!r}; known: {', '.join((*SPLITS, SMALL_TEST))}")
    return "test" if split == SMALL_TEST else split


def kind_seed(recipe: Recipe, split: str, kind: str | None, number: int) -> int:
    """Return the seed of the ``number``-th episode of ``kind`` in a split, or of any kind if None.

    A fixed split wraps around: n consecutive numbers, wherever they begin, are n different episodes as long as the
    split has that many of the kind.
    """
    names = recipe.motion_names
    if kind is not None and kind not in names:
        raise ValueError(f"split {split!r} has no episodes of motion {kind!r}; it has: {', '.join(names)}")
    seeds = range(number + 1) if split == "train" else split_seeds(split)
    if kind is None:
        return seeds[number % len(seeds)]
    offset, stride = names.index(kind), len(names)
    if split == "train":
        return offset + stride * number
    mine = seeds[offset::stride]
    return mine[number % len(mine)]
