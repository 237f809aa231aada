"""The motion that an episode's row describes: its name and its parameters, as JSON."""

from __future__ import annotations

import json
from typing import Any

from dynahoi_lerobot.motions import MOTIONS, Motion


def stored_motion(name: str, parameters: str) -> Motion:
    """Return the motion.

    Raises:
        ValueError: naming what is wrong: an unknown motion, no JSON object, parameters that the motion does not have,
            or that are not written as it writes them.
    """
    try:
        values = json.loads(parameters)
    except ValueError as error:
        raise ValueError(f"parameters is no JSON: {parameters!r}") from error
    if not isinstance(values, dict):
        raise ValueError(f"parameters is no JSON object: {parameters!r}")
    kind = MOTIONS[name]
    try:
        motion = kind(**{key: _tuples(value) for key, value in values.items()})
    except TypeError as error:
        raise ValueError(f"parameters are not those of motion {name!r}: {error}") from error
    if motion.parameters() != parameters:
        raise ValueError(f"parameters are not as motion {name!r} writes them: {parameters!r}")
    return motion


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
