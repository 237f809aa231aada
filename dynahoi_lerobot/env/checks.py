"""What the environments refuse: unknown render modes, seeds that number no episode, use after ``close``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ClosedEnvironmentError

RENDER_MODES = ("rgb_array",)
SEED_LIMIT = 2**40
"""Seeds are below this."""
RANDOM_SEED_LIMIT = 2**31
"""Seeds that the environment draws itself are below this."""


def check_render_mode(mode: str | None) -> None:
    """Refuse a mode that does not exist.

    Raises:
        ValueError: naming the mode received and the ones there are.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise ValueError(f"unknown render mode {mode!r}; known: {', '.join(RENDER_MODES)}, or None")


def check_open(closed: bool) -> None:
    """Refuse to use an environment after ``close``.

    Raises:
        ClosedEnvironmentError: if it is closed.
    """
    if closed:
        raise ClosedEnvironmentError("this environment was closed; make a new one")


def check_seed(seed: Any) -> int:
    """Return ``seed`` as an int.

    Raises:
        ValueError: if it is not an integer from 0 to 2^40 - 1.
    """
    if isinstance(seed, bool | np.bool_) or not isinstance(seed, int | np.integer) or not 0 <= seed < SEED_LIMIT:
        raise ValueError(f"a seed must be an integer from 0 to 2^40 - 1, got {seed!r}")
    return int(seed)


def episode_numbers(seed: int | Sequence[int | None] | None, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return (count,) int64, the number of each world's episode.

    Args:
        seed: the first world's number, from which the others count up; or one for each world, where None is drawn;
            or None to draw all of them.
        count: N.
        rng: draws.

    Raises:
        ValueError: for a wrong count, or a seed that is not an integer from 0 to 2^40 - 1.
    """
    if seed is None:
        return rng.integers(0, RANDOM_SEED_LIMIT, count)
    if not isinstance(seed, Sequence | np.ndarray) or isinstance(seed, str):
        return check_seed(seed) + np.arange(count)
    if len(seed) != count:
        raise ValueError(f"reset needs one seed for each of {count} worlds, got {len(seed)}")
    return np.array([rng.integers(0, RANDOM_SEED_LIMIT) if one is None else check_seed(one) for one in seed], np.int64)
