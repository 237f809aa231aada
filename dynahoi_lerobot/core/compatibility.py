"""Refuse to mix results or datasets of different versions."""

from __future__ import annotations

from collections.abc import Iterable


def refuse_to_mix(noun: str, found: Iterable[tuple[object, str]], remedy: str) -> None:
    """Check that all things have one value of ``noun``.

    Args:
        noun: what must agree, such as ``benchmark``.
        found: pairs of a thing's name and its value.
        remedy: what to do instead, the end of the sentence.

    Raises:
        ValueError: naming the first thing and one that differs, with both values.
    """
    pairs = list(found)
    for name, value in pairs[1:]:
        if value != pairs[0][1]:
            raise ValueError(f"{pairs[0][0]} has {noun} {pairs[0][1]!r}, {name} has {noun} {value!r}; {remedy}")
