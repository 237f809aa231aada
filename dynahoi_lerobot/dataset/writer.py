"""Write a LeRobotDataset v3.0, episode by episode: from Episodes, or from what other datasets hold
of them.

The same episodes give the same bytes, in whatever pieces they were made.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import batched, chain
from pathlib import Path
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq
from av.packet import Packet

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import IMAGE_PREFIX, Feature
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.core.reading import require
from dynahoi_lerobot.dataset import columns as frame_table
from dynahoi_lerobot.dataset import episode_table, paths
from dynahoi_lerobot.dataset.card import write_card
from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.privileged import Privileged, schemas
from dynahoi_lerobot.dataset.statistics import Stats, column_stats, image_stats, pooled, table_stats
from dynahoi_lerobot.dataset.store import Store, StoredEpisode
from dynahoi_lerobot.dataset.video import Encoding, VideoFile, encode

FLUSH_ROWS = 256
MIB = 2**20
VALUES_AT_ONCE = 10**6
"""Frames times columns whose statistics are taken together; reading a few frames costs more for
each column than for each frame."""


def write_episodes(
    root: Path, episodes: Iterable[Episode], encoding: Encoding | None = None
) -> Manifest:
    """Write episodes, in their order, as a new dataset; ``root`` appears atomically.

    The first episode determines the columns: its views and their size, and whether it has
    ``touch``.

    Args:
        root: a path that does not exist yet.
        episodes: one or more, alike in their columns.
        encoding: how images are stored; H.264 video by default.

    Raises:
        FileExistsError: if ``root`` exists.
        ValueError: if there is no episode, or one has other columns than the first.
    """
    if root.exists():
        raise FileExistsError(f"{root} exists; choose a new folder for the dataset")
    remaining = iter(episodes)
    first = next(remaining, None)
    if first is None:
        raise ValueError("got no episodes; a dataset needs at least one")
    columns = frame_table.dataset_features(first)
    with new_folder(root) as folder, DatasetWriter(folder, columns, encoding) as writer:
        for episode in chain([first], remaining):
            writer.add(episode)
        return writer.finish()


class _Tables:
    """Parquet files of one kind: each table is a row group, and a new file begins before one would
    be too large.

    Sizes in memory decide, so that no other version of a compressor begins a file elsewhere.
    """

    def __init__(self, root: Path, template: str, schema: pa.Schema, limits: FileLimits) -> None:
        self.schema = schema
        self.number = -1
        self._root = root
        self._template = template
        self._limits = limits
        self._writer: pq.ParquetWriter | None = None
        self._size_bytes = 0

    def place_for(self, table: pa.Table) -> tuple[int, int]:
        """Make room for ``table``; return the (chunk, file) index that it goes to."""
        if self._writer is None or self._size_bytes + table.nbytes >= self._limits.data_mb * MIB:
            self.close()
            self.number += 1
            self._size_bytes = 0
            path = self._limits.path(self._root, self._template, self.number)
            self._writer = pq.ParquetWriter(
                path, self.schema, compression="snappy", use_dictionary=True
            )
        self._size_bytes += table.nbytes
        return self._limits.place(self.number)

    def append(self, table: pa.Table) -> None:
        """Append ``table`` to the file that ``place_for`` chose."""
        if self._writer is None:
            raise RuntimeError("no file is open; call place_for first")
        self._writer.write_table(table)

    def close(self) -> None:
        """Finish the current file."""
        if self._writer is not None:
            self._writer.close()
        self._writer = None


class DatasetWriter:
    """Writes a dataset into a new folder.

    Until ``finish`` returns, the folder is not a dataset: write into a temporary one and rename it.
    As a context it closes its files whatever happens.
    """

    def __init__(
        self,
        root: Path,
        columns: Sequence[Feature],
        encoding: Encoding | None = None,
        limits: FileLimits | None = None,
        *,
        subtasks: bool = False,
        features: Features | None = None,
    ) -> None:
        """Make the folder ``root``.

        Args:
            root: a path that does not exist yet; its parent does.
            columns: what every episode fills, see ``columns.dataset_features``.
            encoding: how images are stored.
            limits: file size limits.
            subtasks: whether to write subtasks as LeRobot's column for language.
            features: ``info.json``'s feature table of the datasets whose episodes are copied; with
                it, ``columns`` need only be the privileged ones.

        Raises:
            FileExistsError: if ``root`` exists.
            ValueError: if video cannot hold images of this size, or LeRobot cannot open this path.
        """
        paths.check_root(root)
        self._encoding = encoding or Encoding()
        self._encoding.check_size(
            max((column.shape[0] for column in columns if column.is_image), default=0)
        )
        root.mkdir()
        self.root = root
        self.limits = limits or FileLimits()
        self.features = features or frame_table.info_features(
            columns, self._encoding, subtasks=subtasks
        )
        self.episodes = 0
        self.frames = 0
        self._schema = frame_table.arrow_schema(self.features)
        self._data = _Tables(root, paths.DATA_PATH, self._schema, self.limits)
        row_schema = episode_table.row_schema(self.features)
        self._rows = _Tables(root, paths.EPISODES_PATH, row_schema, self.limits)
        by_frame, by_episode = schemas(columns)
        self._privileged = _Tables(root, paths.PRIVILEGED_PATH, by_frame, self.limits)
        self._privileged_episodes = _Tables(
            root, paths.PRIVILEGED_EPISODES_PATH, by_episode, self.limits
        )
        self._pending: list[tuple[EpisodeRow, Privileged]] = []
        self._tasks: dict[str, int] = {}
        self._image_keys = frame_table.image_keys(self.features)
        self._video_keys = frame_table.video_keys(self.features)
        self._image_stats: dict[str, list[Stats]] = {key: [] for key in self._image_keys}
        self._videos: dict[str, VideoFile] = {}
        """The file of each view that is being written; all of them begin and end with the same
        episodes."""
        self._n_videos = 0
        self._columns = tuple(columns)

    def add(self, episode: Episode) -> None:
        """Append one episode, whose images are encoded.

        Raises:
            ValueError: if it has other columns than the dataset, or images of another size.
        """
        check_fits(episode, self._columns)
        images = {IMAGE_PREFIX + view: frames for view, frames in episode.images.items()}
        arrays = frame_table.content_arrays(episode, self._columns)
        row = episode_table.own_columns(episode) | {
            "tasks": [episode.meta.task],
            "length": len(episode),
        }
        stats = table_stats(arrays) | {key: image_stats(images[key]) for key in self._image_keys}
        row |= episode_table.stats_columns(stats)
        columns = frame_table.frame_columns(episode, arrays, self._schema)
        packets = {key: encode(images[key], self._encoding) for key in self._video_keys}
        self._append(row, columns, Privileged.of(episode, self._columns), packets)

    def copy(self, store: Store, stored: StoredEpisode, packets: dict[str, list[Packet]]) -> None:
        """Append one episode that another dataset of the same features holds, without decoding or
        encoding images.

        ``packets`` holds the packets of each view, none without video.

        Raises:
            TypeError, ValueError: if the row lacks a fact, or a value has the wrong type.
        """
        table = stored.frames
        columns = {name: table[name].combine_chunks() for name in table.column_names}
        own = episode_table.without_place(stored.row)
        require(own, episode_table.FACT_TYPES)
        for key in frame_table.numeric_keys(self.features):
            frame_table.column_array(table, key)
        stored.privileged.values()
        videos = {key: store.video_path(stored.row, key) for key in packets}
        self._append(own, columns, stored.privileged, packets, copied_from=videos)

    def finish(
        self, provenance: dict[str, Any] | None = None, yields: dict[str, int] | None = None
    ) -> Manifest:
        """Close every file, write the tables under ``meta/`` and the card, and return the manifest,
        also written.

        Raises:
            ValueError: if no episode was added.
        """
        if not self.episodes:
            raise ValueError("no episode was added; a dataset needs at least one")
        self._data.close()
        self._close_videos()
        self._flush()
        for tables in (self._rows, self._privileged, self._privileged_episodes):
            tables.close()
        _write_tasks(list(self._tasks), self.root / paths.TASKS_PATH)
        paths.write_json(self._info(), self.root / paths.INFO_PATH)
        stats = self._stats()
        as_lists = {
            key: {name: value.tolist() for name, value in stat.items()}
            for key, stat in stats.items()
        }
        paths.write_json(as_lists, self.root / paths.STATS_PATH)
        store = Store(self.root)
        seeds = [row["seed"] for row in store.rows]
        benchmark = ", ".join(sorted({row["benchmark"] for row in store.rows}))
        facts = Manifest(
            self.episodes, self.frames, {}, seeds, provenance or {}, yields or {}, benchmark
        )
        write_card(store, facts)
        manifest = replace(facts, files=hash_files(self.root))
        manifest.write(self.root)
        return manifest

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for video in self._videos.values():
            video.abandon()

    def _append(
        self,
        row: EpisodeRow,
        columns: dict[str, pa.Array],
        privileged: Privileged,
        packets: dict[str, list[Packet]],
        copied_from: Mapping[str, Path] = {},
    ) -> None:
        """Append an episode: its row, columns and privileged rows without place, and its packets,
        with the videos that they were copied from.
        """
        place = (
            self.episodes,
            self.frames,
            self._tasks.setdefault(row["tasks"][0], len(self._tasks)),
        )
        for key, values in frame_table.bookkeeping_arrays(row["length"], *place).items():
            columns[key] = frame_table.flat_array(values, self._schema.field(key).type)
        table = pa.table(
            [columns[key].cast(self._schema.field(key).type) for key in self._schema.names],
            schema=self._schema,
        )
        chunk, file = self._data.place_for(table)
        self._data.append(table)
        row = episode_table.place_row(row, *place) | {
            "data/chunk_index": chunk,
            "data/file_index": file,
        }
        if packets:
            row |= self._append_videos(row["length"], packets, copied_from)
        for key in self._image_keys:
            self._image_stats[key].append(episode_table.row_stats(row, key))
        self._pending.append((row, privileged.placed(self.episodes)))
        self.episodes += 1
        self.frames += row["length"]
        if len(self._pending) == FLUSH_ROWS:
            self._flush()

    def _append_videos(
        self, length: int, packets: dict[str, list[Packet]], copied_from: Mapping[str, Path]
    ) -> EpisodeRow:
        """Append packets to the video of each view; return the columns that say where they are."""
        if not all(self._fits(video, packets[key]) for key, video in self._videos.items()):
            self._close_videos()
        if not self._videos:
            for key in packets:
                path = self.limits.path(self.root, paths.VIDEO_PATH, self._n_videos, video_key=key)
                size = self.features[key]["shape"][0]
                self._videos[key] = VideoFile(path, self._encoding, size, copied_from.get(key))
            self._n_videos += 1
        start = self._videos[next(iter(packets))].frames
        for key, video in self._videos.items():
            video.append(packets[key])
        chunk, file = self.limits.place(self._n_videos - 1)
        times = {
            "from_timestamp": start / CONTROL_HZ,
            "to_timestamp": (start + length) / CONTROL_HZ,
        }
        return episode_table.video_columns(
            packets, {"chunk_index": chunk, "file_index": file} | times
        )

    def _fits(self, video: VideoFile, packets: list[Packet]) -> bool:
        size_bytes = video.size_bytes + sum(packet.size for packet in packets)
        frames = video.frames + len(packets)
        return (
            size_bytes <= self.limits.video_mb * MIB and frames <= self.limits.video_s * CONTROL_HZ
        )

    def _close_videos(self) -> None:
        for video in self._videos.values():
            video.close()
        self._videos = {}

    def _flush(self) -> None:
        """Write the pending episodes' rows of the tables below ``meta/``."""
        if not self._pending:
            return
        rows, privileged = zip(*self._pending, strict=True)
        table = pa.Table.from_pylist(rows, self._rows.schema)
        for name, value in zip(
            ("chunk_index", "file_index"), self._rows.place_for(table), strict=True
        ):
            position = self._rows.schema.get_field_index(f"meta/episodes/{name}")
            cells = pa.array([value] * len(table), pa.int64())
            table = table.set_column(position, self._rows.schema.field(position), cells)
        self._rows.append(table)
        for tables, parts in (
            (self._privileged, [part.frames for part in privileged]),
            (self._privileged_episodes, [part.episode for part in privileged]),
        ):
            schema = tables.schema
            table = pa.concat_tables(part.select(schema.names).cast(schema) for part in parts)
            table = table.combine_chunks()
            tables.place_for(table)
            tables.append(table)
        self._pending.clear()

    def _stats(self) -> dict[str, Stats]:
        """Return the dataset's statistics by key: images' from the statistics of episodes, columns'
        from all frames.
        """
        stats = {key: pooled(found) for key, found in self._image_stats.items()}
        store = Store(self.root)
        at_once = max(1, VALUES_AT_ONCE // self.frames)
        for keys in batched(frame_table.numeric_keys(self.features), at_once):
            for key, values in store.frame_columns(keys).items():
                stats[key] = column_stats(values)
        return stats

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": paths.CODEBASE_VERSION,
            "fps": CONTROL_HZ,
            "features": self.features,
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": self.limits.chunk_files,
            "data_files_size_in_mb": self.limits.data_mb,
            "video_files_size_in_mb": self.limits.video_mb,
            "data_path": paths.DATA_PATH,
            "video_path": paths.VIDEO_PATH if self._video_keys else None,
            "robot_type": paths.ROBOT_TYPE,
            "splits": {"train": f"0:{self.episodes}"},
        }


def check_fits(episode: Episode, features: Sequence[Feature]) -> None:
    """Refuse an episode with other columns.

    Raises:
        ValueError: naming the column, what a frame of the episode has and what the dataset needs.
    """
    wanted = {feature.key: feature.shape for feature in features if not feature.rules_decide}
    found = {feature.key: feature.shape for feature in frame_table.dataset_features(episode)}
    for key in (*wanted, *found):
        if wanted.get(key) != found.get(key):
            raise ValueError(
                f"the episode of seed {episode.meta.seed} has {_described(key, found)}, the "
                f"dataset needs "
                f"{_described(key, wanted)}; all episodes of a dataset must have the same columns"
            )


def _described(key: str, shapes: dict[str, tuple[int, ...]]) -> str:
    return f"{key} of shape {shapes[key]}" if key in shapes else f"no {key}"


def _write_tasks(tasks: list[str], path: Path) -> None:
    """Write LeRobot's task table: pandas must find the texts as the index named ``task``."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": numpy,
            "metadata": None,
        }
        for name, (kind, numpy) in kinds.items()
    ]
    note = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": columns,
        "pandas_version": "2.3.3",
    }
    schema = pa.schema(
        [("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": json.dumps(note)}
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(
        pa.table([list(range(len(tasks))), tasks], schema=schema), path, compression="snappy"
    )
