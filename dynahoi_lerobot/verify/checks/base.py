"""The check contract, and the dataset as checks see it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from dynahoi_lerobot.dataset.columns import column_array, numeric_keys
from dynahoi_lerobot.dataset.episode_table import Row
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.foundation.registry import Registry

CHECKS: Registry[type[Check]] = Registry("check", "dynahoi_lerobot.verify.checks")

Columns = Mapping[str, np.ndarray]
"""An episode's numeric columns by key, each (T, D)."""


@dataclass(frozen=True)
class Finding:
    """One broken promise.

    Attributes:
        check: name of the check that found it.
        message: what is wrong, where, and what was expected.
    """

    check: str
    message: str

    def __str__(self) -> str:
        """Return both on one line."""
        return f"{self.check}: {self.message}"


class Evidence(Store):
    """A dataset on disk, with what several checks need of it.

    Attributes:
        sample: indices of the episodes whose pictures are decoded.
    """

    def __init__(self, root: Path, decoded: int | None) -> None:
        """Look at the dataset below ``root``; ``decoded`` episodes' pictures are looked at, all of them if None."""
        super().__init__(root)
        self._decoded = decoded

    @cached_property
    def sample(self) -> list[int]:
        """Episodes that take turns among the kinds of motion."""
        return stratified(self.rows, len(self.rows) if self._decoded is None else self._decoded)

    @cached_property
    def manifest(self) -> Manifest:
        """The manifest.

        Raises:
            OSError: if there is none.
            ValueError: if it cannot be read.
        """
        return Manifest.read(self.root)

    @cached_property
    def stats_rows(self) -> list[Row]:
        """The rows of the episode table with their statistics."""
        return list(self.full_rows())

    def each_episode(self) -> Iterator[tuple[Row, Columns]]:
        """Yield every episode's row and columns, as many frames as carry its index, file by file."""
        keys = numeric_keys(self.features)
        rows = {row["episode_index"]: row for row in self.stats_rows}
        for path in self.data_files():
            table = pq.read_table(path, columns=keys)
            columns = {key: column_array(table, key) for key in keys}
            index = columns["episode_index"][:, 0]
            starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
            for start, stop in zip(starts, [*starts[1:], len(index)], strict=True):
                row = rows.get(int(index[start]))
                if row is not None:
                    yield row, {key: values[start:stop] for key, values in columns.items()}


class Check:
    """One promise about datasets. Messages are full sentences without a period; a check has either method or both."""

    def dataset(self, evidence: Evidence) -> Iterator[str]:
        """Yield what is wrong with the dataset as a whole."""
        yield from ()

    def episode(self, evidence: Evidence, row: Row, columns: Columns) -> Iterator[str]:
        """Yield what is wrong with one episode."""
        yield from ()


def stratified(rows: list[Row], count: int) -> list[int]:
    """Return ``count`` episode positions, taking turns among the kinds of motion, spread over each kind."""
    kinds: dict[str, list[int]] = {}
    for position, row in enumerate(rows):
        kinds.setdefault(row.get("motion", ""), []).append(position)
    share = -(-count // max(1, len(kinds)))
    spread = [_spread(positions, share) for _, positions in sorted(kinds.items())]
    turns = [positions[turn] for turn in range(share) for positions in spread if turn < len(positions)]
    return sorted(turns[:count])


def _spread(positions: list[int], count: int) -> list[int]:
    chosen = np.unique(np.linspace(0, len(positions) - 1, min(count, len(positions))).round().astype(int))
    return [positions[choice] for choice in chosen]
