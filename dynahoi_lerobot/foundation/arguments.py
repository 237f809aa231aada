"""Argument types that several commands share."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path


def names(text: str) -> tuple[str, ...]:
    """Return the names in a comma-separated list; none if it is empty."""
    return tuple(text.split(",")) if text else ()


def path(text: str) -> Path:
    """Return a path whose leading ``~`` is the home folder, which a shell leaves in ``--root=~/data``.

    Raises:
        ArgumentTypeError: if it is empty, or there is no such home.
    """
    if not text:
        raise ArgumentTypeError("must name a file or folder, got an empty string")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ArgumentTypeError(f"there is no home folder for {text!r}; write the path out") from None


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of a whole number from ``low`` to ``high`` and raises ArgumentTypeError for anything else."""
    return _reader(int, "a whole number", low, high)


def number(low: float, high: float) -> Callable[[str], float]:
    """Return a parser of a finite number from ``low`` to ``high`` and raises ArgumentTypeError for anything else."""
    return _reader(float, "a number", low, high)


def _reader[N: (int, float)](convert: Callable[[str], N], noun: str, low: N, high: N) -> Callable[[str], N]:
    def read(text: str) -> N:
        with suppress(ValueError):
            if low <= (value := convert(text)) <= high:
                return value
        raise ArgumentTypeError(f"must be {noun} from {low} to {high}, got {text or 'nothing'}")

    return read
