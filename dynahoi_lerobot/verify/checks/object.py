"""Solids, size, mass, inertia and contact of the object belong together, and to its name and its motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.core.features import PRIMITIVE_NAMES
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.motions import PrescribedMotion
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.objects.base import FRICTION_RANGE, MASS_RANGE_KG
from dynahoi_lerobot.objects.primitives import Primitive, extent, from_table, solid_inertia
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns
from dynahoi_lerobot.verify.stored_motion import stored_motion

ROUNDING = 1e-5
"""Of numbers in float32, relative to the greatest of a column."""
EXAMPLE_SEED = 0
"""Any draw of an object has the same shapes."""


@CHECKS.register("object")
class ObjectCheck(Check):
    """Computes what follows from solids and mass; impacts have the motion's parameters, prescribed paths have none."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield columns of the object that contradict each other."""
        where = f"episode {row['episode_index']}"
        solids = from_table(np.reshape(row["stats/object_primitives"], (-1, len(PRIMITIVE_NAMES))))
        shapes, wanted = [s.shape for s in solids], [s.shape for s in _example(row["object"])]
        if shapes != wanted:
            yield f"{where}: object {row['object']!r} has the solids {', '.join(shapes)}; it has {', '.join(wanted)}"
        motion = stored_motion(row["motion"], row["parameters"])
        hand, surface = row["stats/object_friction"]
        untouched = isinstance(motion, PrescribedMotion)
        known = {
            "object_size": extent(solids),
            "object_inertia": solid_inertia(solids, row["stats/object_mass"]),
            "object_restitution": getattr(motion, "restitution", 0.0 if untouched else row["stats/object_restitution"]),
            "object_friction": [hand, getattr(motion, "friction", hand if untouched else surface)],
        }
        for name, value in known.items():
            found, given = np.atleast_1d(row[f"stats/{name}"]).astype(float), np.atleast_1d(value).astype(float)
            if found.shape != given.shape or np.abs(found - given).max() > ROUNDING * np.abs(given).max():
                yield f"{where}: {name} is {_listed(found)}; solids, mass and motion give {_listed(given)}"
        yield from (f"{where}: {problem}" for problem in _out_of_range(row))


def _out_of_range(row: EpisodeRow) -> Iterator[str]:
    """Yield a mass and a friction against the hand that no object is drawn with."""
    for name, value, (low, high) in (
        ("object_mass", row["stats/object_mass"], MASS_RANGE_KG),
        ("friction against the hand", row["stats/object_friction"][0], FRICTION_RANGE),
    ):
        if not low - ROUNDING <= value <= high + ROUNDING:
            yield f"{name} is {value:.4g}; {low:g} to {high:g} are possible"


def _example(name: str) -> tuple[Primitive, ...]:
    return OBJECTS[name].sample(np.random.default_rng(EXAMPLE_SEED)).primitives


def _listed(values: np.ndarray) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
