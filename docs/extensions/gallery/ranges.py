"""Ranges of the parameters of motions and of the sizes of objects: least and greatest of many draws."""

from __future__ import annotations

import dataclasses
import inspect
import re

import numpy as np

from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from tests.drawing import draw_motion

DRAWS = 200
ATTRIBUTE = re.compile(r"^    (\w+(?:, \w+)*): (.+(?:\n {8}.+)*)", re.MULTILINE)
Range = tuple[float, float]


def parameter_ranges(kind: str) -> list[tuple[str, str, list[Range]]]:
    """Return name, meaning and ranges (one for each component) of the parameters of a kind of motion."""
    motions = [draw_motion(kind, seed).motion for seed in range(DRAWS)]
    meanings = described_attributes(MOTIONS[kind])
    return [
        (field.name, meanings.get(field.name, ""), _ranges([getattr(motion, field.name) for motion in motions]))
        for field in dataclasses.fields(MOTIONS[kind])  # type: ignore[arg-type]
    ]


def object_ranges(name: str) -> list[tuple[str, str, list[Range]]]:
    """Return name, meaning and ranges of what is drawn for an object."""
    targets = [OBJECTS[name].sample(name, np.random.default_rng(seed)) for seed in range(DRAWS)]
    meanings = described_attributes(type(targets[0]))
    columns = ("mass_kg", "friction", "grasp_radius_m", "rest_height_m", "roll_radius_m")
    return [(column, meanings[column], _ranges([getattr(target, column) for target in targets])) for column in columns]


def described_attributes(entry: type) -> dict[str, str]:
    """Return what the ``Attributes`` of a class and of its bases say, on one line each."""
    found: dict[str, str] = {}
    for cls in reversed(entry.__mro__):
        section = inspect.cleandoc(cls.__doc__ or "").partition("Attributes:\n")[2]
        for names, text in ATTRIBUTE.findall(section):
            found |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return found


def _ranges(values: list[float] | list[tuple[float, ...]]) -> list[Range]:
    """Return least and greatest of each component; none for what is not a number or a vector."""
    try:
        table = np.array(values, float).reshape(len(values), -1)
    except ValueError:  # lists of different lengths
        return []
    return list(zip(table.min(axis=0).tolist(), table.max(axis=0).tolist(), strict=True)) if table.shape[1] <= 3 else []
