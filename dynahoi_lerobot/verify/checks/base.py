"""The check contract, a finding, and the dataset under test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import draccus
import numpy as np
import pyarrow.parquet as pq

from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.dataset.columns import column_array, numeric_keys
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, moved_columns
from dynahoi_lerobot.dataset.files import reading
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH
from dynahoi_lerobot.dataset.quality_control import Columns
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.sampling.recipe import Recipe

CHECKS: Registry[type[Check]] = Registry("check", "dynahoi_lerobot.verify.checks")

LONGEST = 600
"""Characters of a finding that are shown."""


@dataclass(frozen=True)
class Finding:
    """Something wrong with a dataset.

    Attributes:
        check: name of the check that found it.
        message: what is wrong, where, and what was expected.
    """

    check: str
    message: str

    def __str__(self) -> str:
        """Return both on one line, with what cannot be printed escaped: it may come from a hostile dataset."""
        line = f"{self.check}: {self.message}"
        return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in line[:LONGEST])


class CheckedDataset(Store):
    """A dataset on disk, with the tables that several checks share."""

    def __init__(self, root: Path, decoded: int | None) -> None:
        """Open the dataset below ``root``; the pictures of ``decoded`` episodes are decoded, of all if None."""
        super().__init__(root)
        self._decoded = decoded

    @cached_property
    def sample(self) -> list[int]:
        """Indices of the episodes whose pictures are decoded, stratified by kind of motion."""
        return stratified(self.rows, len(self.rows) if self._decoded is None else self._decoded)

    @property
    def has_manifest(self) -> bool:
        """Whether this project wrote the files as they are: other tools drop the manifest."""
        return (self.root / MANIFEST_PATH).is_file()

    @cached_property
    def manifest(self) -> Manifest:
        """The manifest.

        Raises:
            OSError: if there is none.
            ValueError: if it cannot be read.
        """
        return Manifest.read(self.root)

    @cached_property
    def recipe(self) -> Recipe | None:
        """The recipe that the manifest names; None if it names none, or none that this project can read."""
        stored = self.manifest.provenance.get("recipe")
        try:
            return None if stored is None else draccus.decode(Recipe, stored)
        except (draccus.utils.DraccusException, ValueError, TypeError, AttributeError):
            return None

    @cached_property
    def stats_rows(self) -> list[EpisodeRow]:
        """The rows of the episode table with their statistics."""
        return list(self.full_rows())

    def each_episode(self) -> Iterator[tuple[EpisodeRow, Columns]]:
        """Yield every episode's row and columns, as many frames as carry its index, file by file.

        What the frame table leaves to the episode table is among the columns.
        """
        keys = numeric_keys(self.features)
        rows = {row["episode_index"]: row for row in self.stats_rows}
        for path in self.data_files():
            with reading(path):
                table = pq.read_table(path, columns=keys)
            columns = {key: column_array(table, key) for key in keys}
            index = columns["episode_index"][:, 0]
            starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
            for start, stop in zip(starts, [*starts[1:], len(index)], strict=True):
                row = rows.get(int(index[start]))
                if row is not None:
                    yield row, {key: values[start:stop] for key, values in columns.items()} | moved_columns(row)


class Check:
    """One property that every dataset has. A check overrides either method or both; messages end without a period.

    Attributes:
        of_the_format: whether LeRobot's format asks it of any dataset, also of one that another tool has written anew.
    """

    of_the_format: ClassVar[bool] = False

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield what is wrong with the dataset as a whole, once."""
        yield from ()

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield what is wrong with one episode: its row of the episode table and its (T, D) columns."""
        yield from ()


def stratified(rows: list[EpisodeRow], count: int) -> list[int]:
    """Return ``count`` sorted row positions (all if there are fewer), divided evenly among the kinds of motion.

    Where a kind has too few rows, the others give more; within a kind the positions are spread evenly.
    """
    kinds: dict[str, list[int]] = {}
    for position, row in enumerate(rows):
        kinds.setdefault(row.get("motion", ""), []).append(position)
    turns = [(turn, kind) for kind, positions in kinds.items() for turn in range(len(positions))]
    shares = Counter(kind for _, kind in sorted(turns)[:count])
    return sorted(position for kind, share in shares.items() for position in _spread(kinds[kind], share))


def _spread(positions: list[int], count: int) -> list[int]:
    chosen = np.linspace(0, len(positions) - 1, count).round().astype(int)
    return [positions[choice] for choice in chosen]
