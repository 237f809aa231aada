"""The interface of a part: a function that looks at the machine and yields facts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from dynahoi_lerobot.foundation.registry import Registry


@dataclass(frozen=True)
class Fact:
    """One thing that this machine has, or lacks.

    Attributes:
        name: what was looked at.
        found: what is there, with units.
        follows: what that means for the commands; empty if nothing.
        problem: whether something that the installed commands need is not there or not as it should be.
    """

    name: str
    found: str
    follows: str = ""
    problem: bool = False


Look = Callable[[Path], Iterator[Fact]]
"""Takes the folder in which output would go."""

PARTS: Registry[Look] = Registry("part", "dynahoi_lerobot.doctor.parts")


def part(name: str) -> Callable[[Look], Look]:
    """Return a decorator that makes ``dynahoi doctor`` look at the part ``name``."""
    return PARTS.register(name)


def examine(folder: Path) -> Iterator[Fact]:
    """Yield the facts of every part, by name of the part; a part that cannot be looked at is a problem.

    Args:
        folder: where output would go.
    """
    for name, look in PARTS.items():
        try:
            yield from look(folder)
        except Exception as error:  # whatever a broken installation raises is what the user wants to know
            yield Fact(name, f"cannot be looked at: {type(error).__name__}: {error}", problem=True)
