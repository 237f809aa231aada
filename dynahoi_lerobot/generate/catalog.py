"""Everything under ``meta/``, built one episode at a time by the writer, and again when shards are merged."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.conventions import CONTROL_HZ
from dynahoi_lerobot.generate.features import BOOKKEEPING, Features, content_keys, numeric_keys
from dynahoi_lerobot.generate.histograms import SHOWN, histograms
from dynahoi_lerobot.generate.layout import (
    CODEBASE_VERSION,
    DATA_PATH,
    EPISODES_PATH,
    HISTOGRAMS_PATH,
    INFO_PATH,
    ROBOT_TYPE,
    STATS_PATH,
    TASKS_PATH,
    VIDEO_PATH,
    Layout,
)
from dynahoi_lerobot.generate.quantiles import exact_quantiles, weighted_quantiles
from dynahoi_lerobot.generate.rows import Row, place_row, row_schema, row_stats
from dynahoi_lerobot.generate.statistics import Moments, Stats, picture_stats
from dynahoi_lerobot.generate.tables import RollingParquet, write_tasks
from dynahoi_lerobot.spec import CAMERA_KEY

FLUSH_ROWS = 256


class Catalog:
    """The tables of a dataset that describe it: info, statistics, tasks and one row per episode."""

    def __init__(self, root: Path, features: Features, layout: Layout) -> None:
        """Describe the dataset below ``root``, whose frames have these features."""
        self.root, self.features, self.layout = root, features, layout
        self.episodes = self.frames = 0
        self.tasks: dict[str, int] = {}
        self._task_frames: Counter[int] = Counter()
        self._lengths: list[int] = []
        self._moments = {key: Moments() for key in numeric_keys(features)}
        self._pictures = 0
        self._schema = row_schema(features)
        self._files = RollingParquet(root, EPISODES_PATH, self._schema, layout)
        self._pending: list[Row] = []

    def next_place(self, task: str) -> tuple[int, int, int]:
        """Return the episode, first frame and task indices of the episode that is added next."""
        return self.episodes, self.frames, self.tasks.setdefault(task, len(self.tasks))

    def add(self, row: Row) -> None:
        """Add one episode's row; its place and the statistics that follow from it are filled in."""
        episode_index, first_index, task_index = self.next_place(row["tasks"][0])
        row = place_row(row, episode_index, first_index, task_index)
        for key, moments in self._moments.items():
            moments.add(row_stats(row, key))
        if CAMERA_KEY in self.features:
            self._pictures += row[f"stats/{CAMERA_KEY}/count"][0]
        self._task_frames[task_index] += row["length"]
        self._lengths.append(row["length"])
        self.episodes += 1
        self.frames += row["length"]
        self._pending.append(row)
        if len(self._pending) == FLUSH_ROWS:
            self._flush()

    def finish(self, histogram: np.ndarray | None) -> None:
        """Write the tables; the data files must be closed.

        Args:
            histogram: (3, 256) counts of the sampled pictures, None without a camera.
        """
        self._flush()
        self._files.close()
        write_tasks(list(self.tasks), self.root / TASKS_PATH)
        write_json(self._info(), self.root / INFO_PATH)
        stats = self._stats(histogram)
        as_lists = {key: {name: value.tolist() for name, value in stat.items()} for key, stat in stats.items()}
        write_json(as_lists, self.root / STATS_PATH)
        batches = {key: lambda key=key: numeric_batches(self.root, [key]) for key in SHOWN}
        write_json(histograms(batches, self.features, stats), self.root / HISTOGRAMS_PATH)

    def _flush(self) -> None:
        if not self._pending:
            return
        table = pa.Table.from_pylist(self._pending, self._schema)
        chunk, file = self._files.upcoming(table)
        for name, value in (("chunk_index", chunk), ("file_index", file)):
            position = self._schema.get_field_index(f"meta/episodes/{name}")
            cells = pa.array([value] * len(table), pa.int64())
            table = table.set_column(position, self._schema.field(position), cells)
        self._files.append(table)
        self._pending.clear()

    def _info(self) -> dict[str, Any]:
        has_video = any(feature["dtype"] == "video" for feature in self.features.values())
        return {
            "codebase_version": CODEBASE_VERSION,
            "fps": CONTROL_HZ,
            "features": self.features,
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": self.layout.chunk_files,
            "data_files_size_in_mb": self.layout.data_mb,
            "video_files_size_in_mb": self.layout.video_mb,
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if has_video else None,
            "robot_type": ROBOT_TYPE,
            "splits": {"train": f"0:{self.episodes}"},
        }

    def _stats(self, histogram: np.ndarray | None) -> dict[str, Stats]:
        quantiles = self._content_quantiles() | self._bookkeeping_quantiles()
        stats = {key: moments.stats(quantiles[key]) for key, moments in self._moments.items()}
        if histogram is not None:
            stats = {CAMERA_KEY: picture_stats(histogram, self._pictures)} | stats
        return stats

    def _content_quantiles(self) -> dict[str, Stats]:
        keys = content_keys(self.features)
        widths = [self.features[key]["shape"][0] for key in keys]
        edges = np.cumsum([0, *widths])
        wide = exact_quantiles(lambda: numeric_batches(self.root, keys))
        return {
            key: {name: value[start:stop].astype(np.float64) for name, value in wide.items()}
            for key, start, stop in zip(keys, edges[:-1], edges[1:], strict=True)
        }

    def _bookkeeping_quantiles(self) -> dict[str, Stats]:
        lengths = np.array(self._lengths)
        longest = np.arange(lengths.max())
        present = _survivors(lengths)
        tasks = sorted(self._task_frames)
        weights = {
            "timestamp": ((longest / CONTROL_HZ).astype(np.float32), present),
            "frame_index": (longest, present),
            "episode_index": (np.arange(len(lengths)), lengths),
            "index": (np.arange(self.frames), np.ones(self.frames, np.int64)),
            "task_index": (np.array(tasks), np.array([self._task_frames[task] for task in tasks])),
        }
        return {
            key: {name: np.array([value]) for name, value in weighted_quantiles(*weights[key]).items()}
            for key in BOOKKEEPING
        }


def numeric_batches(root: Path, keys: list[str]) -> Iterator[np.ndarray]:
    """Yield the given columns of each data file side by side, (n, D) float32."""
    for path in sorted((root / "data").glob("*/*.parquet")):
        table = pq.read_table(path, columns=keys)
        yield np.concatenate([column_array(table, key) for key in keys], axis=1, dtype=np.float32, casting="unsafe")


def column_array(table: pa.Table, key: str) -> np.ndarray:
    """Return a numeric column as (n, D)."""
    column = table[key].combine_chunks()
    width = 1
    if pa.types.is_fixed_size_list(column.type):
        width, column = column.type.list_size, column.flatten()
    return column.to_numpy(zero_copy_only=False).reshape(-1, width)  # (n, D)


def write_json(value: Any, path: Path) -> None:
    """Write JSON the way LeRobot does, so that a later edit by its tools shows only what it changed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False))


def _survivors(lengths: np.ndarray) -> np.ndarray:
    """Return how many episodes reach each frame index, (max length,)."""
    ended = np.bincount(lengths, minlength=lengths.max() + 1)
    return len(lengths) - np.cumsum(ended)[:-1]
