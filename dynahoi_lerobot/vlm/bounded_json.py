"""Decoding JSON from a server that is not trusted: bounded in depth and in the digits of a number."""

from __future__ import annotations

import json
import math
import re
from typing import Any

MAX_DEPTH = 32
"""Levels of arrays and objects; a chat completion has about 6, and an answer has 4."""
MAX_DIGITS = 64
"""Characters of one number; a float64 needs at most 24."""
TOKENS = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+"?+|[\[{]|[\]}]', re.DOTALL)
"""Strings, whose brackets do not count, and brackets."""


def decode_json(text: str) -> Any:
    """Return the value of a JSON text.

    ``NaN`` and infinities are accepted as in Python, and a number of more than `MAX_DIGITS` characters is read as NaN,
    so that one senseless number in a field of no importance does not cost the answer. Whoever uses a number must check
    that it is finite.

    Raises:
        ValueError: if the text is no JSON, or nested more deeply than `MAX_DEPTH`.
    """
    _check_depth(text)
    return json.loads(text, parse_int=_number(int), parse_float=_number(float))


def _check_depth(text: str) -> None:
    depth = 0
    for token in TOKENS.finditer(text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(token[0], 0)
        if depth > MAX_DEPTH:
            raise ValueError(f"nested more than {MAX_DEPTH} levels deep")


def _number(kind: type) -> Any:
    return lambda digits: kind(digits) if len(digits) <= MAX_DIGITS else math.nan
