"""What the feature table says of one array of an episode."""

from __future__ import annotations

import math
from dataclasses import dataclass

OBSERVATION_PREFIX = "observation."
"""LeRobot gives policies the columns of this prefix, and no others."""
NEXT_PREFIX = "next."
"""LeRobot's own columns of what an action led to."""
IMAGE_PREFIX = OBSERVATION_PREFIX + "images."
EPISODE_TABLE_PREFIX = "stats/"
"""Columns of the episode table. LeRobot reads an episode's whole row for every sample, except for this prefix, and all
columns of every frame's row: no training pays for what is here."""


@dataclass(frozen=True)
class Feature:
    """One array of an episode.

    Attributes:
        name: attribute of ``Episode``, and of ``Observation`` if policies may see it.
        key: column of the dataset: of the frame table, or of the episode table if it begins with ``stats/``.
        shape: of one frame, () for a number, which the dataset stores as (1,). What policies see has two elements
            or more, because LeRobot cannot stream windows over one.
        names: of the elements, in order.
        unit: of the elements.
        meaning: what it is, with its frame of reference.
        dtype: element type in ``Episode`` and in the dataset.
        gym_key: key in the Gymnasium observation (``group/key`` if nested); None for privileged features.
        low: least value in the Gymnasium space, in ``unit``; values beyond are clipped.
        high: greatest value, likewise.
        needs_contact_sensors: whether only capture rules with ``uses_contact_sensors`` have it.
        on_policy: whether only on-policy recordings have it, see ``rollout.on_policy``.
        on_request: whether policies and datasets get it only if that is asked for: it is the simulator's truth.
        constant: whether it has one value per episode; a frame table repeats that value in every row.
        per: what its rows are if it is not constant: ``frame``, or ``attempt`` or ``primitive``, whose number differs
            between episodes; only the episode table can hold those.
        derived: whether it follows from other attributes: a property of ``Episode``, which is stored but not read.
    """

    name: str
    key: str
    shape: tuple[int, ...]
    names: tuple[str, ...]
    unit: str
    meaning: str
    dtype: str = "float32"
    gym_key: str | None = None
    low: float = -math.inf
    high: float = math.inf
    needs_contact_sensors: bool = False
    on_policy: bool = False
    on_request: bool = False
    constant: bool = False
    per: str = "frame"
    derived: bool = False

    @property
    def column_shape(self) -> tuple[int, ...]:
        """Shape of one row of the column."""
        return self.shape or (1,)

    @property
    def observed(self) -> bool:
        """Whether policies see it."""
        return self.key.startswith(OBSERVATION_PREFIX)

    @property
    def privileged(self) -> bool:
        """Whether it is for experts, metrics and auxiliary losses only."""
        return self.gym_key is None

    @property
    def optional(self) -> bool:
        """Whether some recordings do not have it."""
        return self.needs_contact_sensors or self.on_policy or self.on_request

    @property
    def is_image(self) -> bool:
        """Whether it is the images of a view."""
        return self.key.startswith(IMAGE_PREFIX)

    @property
    def in_episode_table(self) -> bool:
        """Whether the dataset stores it in the episode table instead of the frame table."""
        return self.key.startswith(EPISODE_TABLE_PREFIX)

    @property
    def has_fixed_shape(self) -> bool:
        """Whether all episodes of one length have it in one shape."""
        return self.constant or self.per == "frame"

    def array_shape(self, frames: int) -> tuple[int, ...]:
        """Return the shape of the attribute in an ``Episode`` of ``frames`` frames, if it ``has_fixed_shape``."""
        return self.shape if self.constant else (frames, *self.shape)
