"""Build a dataset from stored episodes of others, without decoding or encoding images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.dataset.card.readme import finish_with_card
from dynahoi_lerobot.dataset.columns import arrow_schema, bookkeeping_arrays
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, video_columns, without_place
from dynahoi_lerobot.dataset.files import reading
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.metadata import MetadataWriter
from dynahoi_lerobot.dataset.paths import DATA_PATH, VIDEO_PATH, FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.tables import RollingParquet


class Assembly:
    """A new dataset, built from stored episodes one by one."""

    def __init__(self, root: Path, like: Store, limits: FileLimits) -> None:
        """Make the folder ``root`` for episodes with the features of ``like``."""
        root.mkdir()
        self.root, self.limits = root, limits
        self._schema = arrow_schema(like.features)
        self._metadata = MetadataWriter(root, like.features, limits)
        self._data = RollingParquet(root, DATA_PATH, self._schema, limits)
        self._pictures, self._videos = like.pictures, 0
        self._hashes: dict[str, str] = {}
        self._seeds: list[int] = []

    def next_videos(self) -> dict[str, Path]:
        """Return the path of the next video file of each view, by its key; their folders exist."""
        self._videos += 1
        number = self._videos - 1
        return {key: self.limits.path(self.root, VIDEO_PATH, number, video_key=key) for key in self._pictures}

    def video_place(self) -> EpisodeRow:
        """Return the columns that name the latest video files."""
        chunk, file = self.limits.place(self._videos - 1)
        return video_columns(self._pictures, {"chunk_index": chunk, "file_index": file})

    def set_known_hash(self, path: Path, digest: str) -> None:
        """Set the sha256 of a linked file, so that it is not read again."""
        self._hashes[path.relative_to(self.root).as_posix()] = digest

    def add(self, row: EpisodeRow, table: pa.Table) -> None:
        """Add one episode.

        Args:
            row: its row of the episode table, from ``without_place``, with the columns of ``video_place``.
            table: its frames; LeRobot's index columns are numbered anew.
        """
        place = self._metadata.next_place(row["tasks"][0])
        for key, values in bookkeeping_arrays(row["length"], *place).items():
            position = self._schema.get_field_index(key)
            field = self._schema.field(position)
            table = table.set_column(position, field, pa.array(values, field.type))
        chunk, file = self._data.write(table.cast(self._schema))
        self._metadata.add(row | {"data/chunk_index": chunk, "data/file_index": file})
        self._seeds.append(row["seed"])

    def finish(self, provenance: dict[str, Any], yields: dict[str, int]) -> Manifest:
        """Write the tables, the card and the manifest."""
        self._data.close()
        self._metadata.finish()
        metadata = self._metadata
        hashes = hash_files(self.root, self._hashes)
        manifest = Manifest(
            metadata.episodes, metadata.frames, hashes, self._seeds, provenance, yields, metadata.benchmark
        )
        return finish_with_card(self.root, manifest)


def stored_episodes(store: Store) -> Iterator[tuple[EpisodeRow, pa.Table]]:
    """Yield every episode's row, without its place in the tables, and its frames; each file is read once."""
    path, table, used = Path(), pa.table({}), 0
    for row in store.full_rows():
        if (holder := store.data_path(row)) != path:
            with reading(holder):
                path, table, used = holder, pq.read_table(holder), 0
        yield without_place(row), table.slice(used, row["length"]).combine_chunks()
        used += row["length"]
