"""Target slots: how many geoms of each shape the target body carries, of which a world fills those its object uses."""

from __future__ import annotations

import functools
from collections import Counter

import mujoco
import numpy as np

from dynahoi_lerobot.objects import OBJECTS, ObjectType

SHAPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
TARGET_SLOTS = {"box": 1, "capsule": 8, "cylinder": 6, "ellipsoid": 1, "sphere": 2}
"""Geoms of each shape that the target body always carries: what the benchmark's objects need, held-out ones included.

Fixed rather than counted, so that geom ids, and with them contact order and bytes, do not depend on what is registered.
"""

LARGEST_SLOT_M = 0.12
"""Half-size with which slots are compiled [m]; an object's primitives are no larger."""


def extra_slots() -> Counter[str]:
    """Return how many slots of each shape the registered objects need beyond ``TARGET_SLOTS``.

    An object is drawn once to count its primitives, from seed 0.
    """
    most: Counter[str] = Counter()
    for _, object_type in OBJECTS.items():
        most |= _primitive_counts(object_type)
    return most - Counter(TARGET_SLOTS)


@functools.cache
def _primitive_counts(object_type: ObjectType) -> Counter[str]:
    return Counter(primitive.shape for primitive in object_type.sample(np.random.default_rng(0)).primitives)
