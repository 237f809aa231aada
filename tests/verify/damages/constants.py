"""Columns of object, cameras, limits, plan and outcome that others contradict; statistics and hashes agree."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.objects.primitives import extent, from_table, solid_inertia
from tests.verify.forgery import Damage, Table, at, entry_of, forge


def constant(name: str, change, episode: int = 0) -> Damage:
    """Return a forgery of one of the episode table's constants, with another value in its place."""

    def apply(row, columns):
        value = np.asarray(row[f"stats/{name}"])
        row[f"stats/{name}"] = np.asarray(change(value), value.dtype).tolist()

    return forge(apply, episode)


def larger(row, columns):
    """All that follows from the solids agrees with them."""
    table = np.reshape(row["stats/object_primitives"], (-1, 11))
    table[:, 1:7] *= 1.2
    solids = from_table(table)
    row["stats/object_primitives"] = table.ravel().tolist()
    row["stats/object_size"] = extent(solids).tolist()
    row["stats/object_inertia"] = list(solid_inertia(solids, row["stats/object_mass"]))


def heavier(row, columns):
    row["stats/object_mass"] = 0.15
    solids = from_table(np.reshape(row["stats/object_primitives"], (-1, 11)))
    row["stats/object_inertia"] = list(solid_inertia(solids, 0.15))


CONSTANTS: Table = {
    "another size of the object": (constant("object_size", lambda x: x + 0.01), "default", "object_size is"),
    "a larger object": (forge(larger), "default", "fingertip_distance is"),
    "a geom type that is none": (entry_of("object_primitives", 0, lambda x: 9.0), "default", "geom type 9 is none of"),
    "another mass": (constant("object_mass", lambda x: x * 1.3), "default", "object_inertia is"),
    "another mass with its inertia": (forge(heavier), "replay", "another stats/object_"),
    "a mass beyond the range": (constant("object_mass", lambda x: x + 1), "default", "0.04 to 0.18 are possible"),
    "another friction": (constant("object_friction", lambda x: x * 0 + 0.7), "replay", "another stats/object_friction"),
    "another friction of a path": (constant("object_friction", lambda x: x * [1, 0.9]), "default", "object_friction"),
    "another restitution": (constant("object_restitution", lambda x: x + 0.5), "default", "object_restitution is 0.5"),
    "the hand's camera turned": (entry_of("ego_camera", 4, lambda x: x + 0.1), "default", "ego_camera is"),
    "the side camera moved": (entry_of("side_camera", 0, lambda x: x + 0.1), "default", "side_camera is"),
    "another focal length": (entry_of("ego_intrinsics", 0, lambda x: x + 1), "default", "ego_intrinsics is"),
    "another principal point": (entry_of("side_intrinsics", 3, lambda x: x + 1), "default", "side_intrinsics is"),
    "other hand limits": (entry_of("hand_limits", 2, lambda x: 150.0), "default", "hand_limits is [0.5, 20.0, 150.0]"),
    "another planned speed": (entry_of("first_plan", 0, lambda x: x + 0.1), "default", "from home then"),
    "half a frame of lead time": (entry_of("first_plan", 1, lambda x: x + 0.025), "default", "frames last 0.05 s"),
    "another planned speed of a throw": (
        constant("first_plan", lambda x: x + [0.1, 0], 1), "replay", "another stats/first_plan"
    ),
    "an attempt more": (constant("attempt_success", lambda x: [False, *x]), "default", "attempt_success is"),
    "a reward at the end": (at("next.reward", -1, 1.0), "default", "next.reward is 1.0; rule 'attach' says 0.0"),
    "no reward": (at("next.reward", slice(None), 0.0), "default", "next.reward is 0.0; rule 'attach' says 1.0"),
    "done early": (at("next.done", 5, True), "default", "frame 5: next.done is True"),
    "never done": (at("next.done", slice(None), False), "default", "next.done is False"),
    "a success from the start": (at("next.success", slice(None), True), "default", "frame 0: next.success is True"),
}  # fmt: skip
