"""What several commands read from their command line in the same way."""

from __future__ import annotations


def names(text: str) -> tuple[str, ...]:
    """Return the names in a comma-separated list; none if it is empty."""
    return tuple(text.split(",")) if text else ()
