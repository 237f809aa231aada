"""What several commands read from their command line in the same way."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable
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
    """Return what reads a whole number from ``low`` to ``high``.

    It raises ArgumentTypeError, which names both, for anything else.
    """

    def read(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = low - 1
        if not low <= number <= high:
            raise ArgumentTypeError(f"must be a whole number from {low} to {high}, got {text}")
        return number

    return read
