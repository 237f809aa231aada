"""The tables under ``meta/``, built one episode at a time, by the writer and when datasets are merged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.dataset_stats import DatasetStats
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, place_row, row_schema
from dynahoi_lerobot.dataset.paths import (
    CODEBASE_VERSION,
    DATA_PATH,
    EPISODES_PATH,
    HISTOGRAMS_PATH,
    INFO_PATH,
    ROBOT_TYPE,
    STATS_PATH,
    TASKS_PATH,
    VIDEO_PATH,
    FileLimits,
)
from dynahoi_lerobot.dataset.tables import RollingParquet, write_tasks

FLUSH_ROWS = 256


class MetadataWriter:
    """Writes info, statistics, tasks and the episode table of a dataset."""

    def __init__(self, root: Path, features: Features, limits: FileLimits) -> None:
        """Start with no episode; files go below ``root``, which exists."""
        self.root, self.features, self.limits = root, features, limits
        self.episodes = self.frames = 0
        self.tasks: dict[str, int] = {}
        self._benchmarks: set[str] = set()
        self._summary = DatasetStats(features)
        self._schema = row_schema(features)
        self._files = RollingParquet(root, EPISODES_PATH, self._schema, limits)
        self._pending: list[EpisodeRow] = []

    def next_place(self, task: str) -> tuple[int, int, int]:
        """Return the episode, first frame and task indices of the episode that is added next."""
        return self.episodes, self.frames, self.tasks.setdefault(task, len(self.tasks))

    def add(self, row: EpisodeRow) -> None:
        """Add one episode's row; its place and the statistics that follow from it are filled in."""
        row = place_row(row, *self.next_place(row["tasks"][0]))
        self._summary.add(row)
        self._benchmarks.add(row["benchmark"])
        self.episodes += 1
        self.frames += row["length"]
        self._pending.append(row)
        if len(self._pending) == FLUSH_ROWS:
            self._flush()

    @property
    def benchmark(self) -> str:
        """Version of the benchmark that the episodes are of; all of them where versions were mixed on purpose."""
        return ", ".join(sorted(self._benchmarks))

    def finish(self) -> None:
        """Write the tables; the data files must be closed."""
        self._flush()
        self._files.close()
        write_tasks(list(self.tasks), self.root / TASKS_PATH)
        write_json(self._info(), self.root / INFO_PATH)
        stats = self._summary.stats(self.root)
        as_lists = {key: {name: value.tolist() for name, value in stat.items()} for key, stat in stats.items()}
        write_json(as_lists, self.root / STATS_PATH)
        write_json(self._summary.histograms(self.root, stats), self.root / HISTOGRAMS_PATH)

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
            "chunks_size": self.limits.chunk_files,
            "data_files_size_in_mb": self.limits.data_mb,
            "video_files_size_in_mb": self.limits.video_mb,
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if has_video else None,
            "robot_type": ROBOT_TYPE,
            "splits": {"train": f"0:{self.episodes}"},
        }


def write_json(value: Any, path: Path) -> None:
    """Write JSON the way LeRobot does, so that a later edit by its tools shows only what it changed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False))
