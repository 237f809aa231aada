"""The privileged tables: what metrics and teachers read and no policy may see.

``meta/privileged`` has a row per frame, in the order of the frame table. In
``meta/privileged_episodes`` are constants and arrays whose rows are not frames, a row per episode.
A cell is a number, or nested lists of the feature's shape. LeRobot fetches both with ``meta/`` and
reads neither, so they cost no training anything; ``dataset.frame_column`` and
``dataset.episode_column`` read them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import Feature, privileged_features
from dynahoi_lerobot.core.reading import ReadError, read_table
from dynahoi_lerobot.dataset.columns import SCALARS, Table, column_array, flat_array

FRAME_KEYS = ("episode_index", "frame_index")
EPISODE_KEYS = ("episode_index",)
"""Columns by which the rows of either table are found."""

DROPPED = "LeRobot's tools do not keep them; take the dataset from before, or `dynahoi filter`"
"""Advice about tables that are missing or belong to other episodes."""


def schemas(features: Iterable[Feature]) -> tuple[pa.Schema, pa.Schema]:
    """Return the schemas of both tables: of ``features``, the privileged ones count."""
    frames: dict[str, pa.DataType] = dict.fromkeys(FRAME_KEYS, pa.int64())
    episodes: dict[str, pa.DataType] = dict.fromkeys(EPISODE_KEYS, pa.int64())
    for feature in features:
        if feature.privileged:
            columns = frames if feature.per == "frame" else episodes
            columns[feature.key] = _row_type(feature)
    return pa.schema(frames), pa.schema(episodes)


def _row_type(feature: Feature) -> pa.DataType:
    """The type of a cell: nested lists, of a fixed size where every episode has the same."""
    kind: pa.DataType = SCALARS[feature.dtype]
    for size in reversed(feature.shape):
        kind = pa.list_(kind, size)
    return pa.list_(kind) if feature.is_ragged else kind


@dataclass(frozen=True)
class Privileged:
    """What is privileged of one episode.

    Attributes:
        frames: its T rows of ``meta/privileged``.
        episode: its row of ``meta/privileged_episodes``.
    """

    frames: pa.Table
    episode: pa.Table

    @classmethod
    def of(cls, episode: Episode, features: Sequence[Feature]) -> Self:
        """Return the rows of an episode without their keys: of ``features``, the privileged ones
        count.
        """
        own = [feature for feature in features if feature.privileged]
        arrays = {f.key: np.asarray(getattr(episode, f.name), f.dtype) for f in own}
        frames = {f.key: flat_array(arrays[f.key], _row_type(f)) for f in own if f.per == "frame"}
        row = {
            f.key: pa.array([arrays[f.key].tolist()], _row_type(f)) for f in own if f.per != "frame"
        }
        return cls(pa.table(frames), pa.table(row))

    def placed(self, episode_index: int) -> Self:
        """Return the rows with the keys of an episode of this index."""
        number = np.arange(len(self.frames))
        keys = {"episode_index": np.full_like(number, episode_index), "frame_index": number}
        return type(self)(
            _with_columns(self.frames, keys),
            _with_columns(self.episode, {"episode_index": np.array([episode_index])}),
        )

    def values(self) -> dict[str, Any]:
        """Return the attributes of an Episode that the rows hold: undoes ``of``.

        Raises:
            KeyError: if a column is missing.
            ValueError: if a cell has another shape or type than its feature.
        """
        return {f.name: self._value(f) for f in privileged_features() if not f.derived}

    def _value(self, feature: Feature) -> Any:
        if feature.per == "frame":
            rows = column_array(self.frames, feature.key)  # (T, D)
            return rows.astype(feature.dtype, copy=False).reshape(len(rows), *feature.shape)
        array = cell_array(self.episode[feature.key][0].as_py(), feature)
        if feature.shape:
            return array
        return array[:, 0] if feature.is_ragged else array.item()


def cell_array(cell: Any, feature: Feature) -> np.ndarray:
    """Return a cell of ``meta/privileged_episodes`` as (D,), or (rows, D) where it is ragged.

    Raises:
        ValueError: if it is null or of another shape.
    """
    if cell is None:
        raise ValueError(f"its column {feature.key} has a row without a value")
    shape = (-1, *feature.column_shape) if feature.is_ragged else feature.column_shape
    return np.array(cell, feature.dtype).reshape(shape)


def _with_columns(table: pa.Table, columns: dict[str, np.ndarray]) -> pa.Table:
    """Return a table with these columns in place of its own, or beside them."""
    own = {name: table[name] for name in table.column_names}
    return pa.table(own | {name: pa.array(values) for name, values in columns.items()})


class PrivilegedTables:
    """The privileged tables of a dataset on disk; one that another tool has edited may have none,
    or the tables of other episodes.

    Attributes:
        frames, episodes: both tables.
    """

    def __init__(self, root: Path, lengths: Callable[[], np.ndarray]) -> None:
        """Look for the tables below ``root``, a dataset whose episodes have ``lengths`` [frames],
        (E,).
        """
        self._root = root
        self._lengths = lengths
        self.frames = Table(root / "meta/privileged")
        self.episodes = Table(root / "meta/privileged_episodes")

    @cached_property
    def features(self) -> list[Feature]:
        """The columns of both tables, in the order of the feature table."""
        names = self.frames.names() | self.episodes.names()
        return [feature for feature in privileged_features() if feature.key in names]

    def feature(self, key: str) -> Feature:
        """Return one of ``features`` by its key; ValueError if there is none."""
        for feature in self.features:
            if feature.key == key:
                return feature
        if self.features:
            raise ValueError(f"{self._root} has no column of numbers {key!r}")
        raise ValueError(f"{self._root} has no column {key!r} and no privileged tables: {DROPPED}")

    @cached_property
    def problem(self) -> str:
        """Why they cannot be read; empty if every frame and every episode has its row.

        Raises:
            ReadError: if a file is damaged.
        """
        if not (self.frames.files and self.episodes.files):
            return f"{self._root} has no privileged tables: {DROPPED}"
        number, frame = (keys[:, 0] for keys in self.frames.columns(FRAME_KEYS))
        (index,) = (keys[:, 0] for keys in self.episodes.columns(EPISODE_KEYS))
        lengths = self._lengths()
        episode = np.repeat(np.arange(len(lengths)), lengths)  # of each frame
        first = np.cumsum(lengths) - lengths
        if (
            np.array_equal(index, np.arange(len(lengths)))
            and np.array_equal(number, episode)
            and np.array_equal(frame, np.arange(len(episode)) - first[episode])
        ):
            return ""
        return f"{self._root} has the privileged tables of other episodes: {DROPPED}"

    def rows(self, feature: Feature) -> np.ndarray:
        """Return a column of the table of frames, (N, D); ReadError as ``problem`` says."""
        self._check()
        (values,) = self.frames.columns([feature.key])
        return values.astype(feature.dtype, copy=False)

    def cells(self, feature: Feature) -> list[np.ndarray]:
        """Return a column of the table of episodes, an array for each; ReadError as ``problem``
        says.
        """
        self._check()
        tables = (read_table(path, [feature.key]) for path in self.episodes.files)
        return [
            cell_array(cell, feature) for table in tables for cell in table[feature.key].to_pylist()
        ]

    def episode(self, index: int, first: int, stop: int) -> Privileged:
        """Return the rows of an episode, whose frames are numbered ``first`` to ``stop``
        (excluded); ReadError as ``problem`` says.
        """
        self._check()
        return Privileged(self.frames.rows(first, stop), self.episodes.rows(index, index + 1))

    def _check(self) -> None:
        if self.problem:
            raise ReadError(self.problem)
