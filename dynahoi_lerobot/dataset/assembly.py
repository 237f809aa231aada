"""Assembly: put stored episodes together into another dataset; no picture is decoded or encoded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.dataset.columns import arrow_schema, bookkeeping_arrays
from dynahoi_lerobot.dataset.episode_table import Row, video_columns, without_place
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.metadata import Catalog
from dynahoi_lerobot.dataset.paths import DATA_PATH, VIDEO_PATH, Layout
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.tables import RollingParquet


class Assembly:
    """A dataset that grows by episodes of others."""

    def __init__(self, root: Path, like: Store, layout: Layout) -> None:
        """Make the folder ``root`` for episodes with the features of ``like``."""
        root.mkdir()
        self.root, self.layout = root, layout
        self._schema = arrow_schema(like.features)
        self._catalog = Catalog(root, like.features, layout)
        self._data = RollingParquet(root, DATA_PATH, self._schema, layout)
        self._pictures, self._videos = like.pictures, 0
        self._hashes: dict[str, str] = {}
        self._seeds: list[int] = []

    def next_videos(self) -> dict[str, Path]:
        """Return the path of the next video file of each view, by its key; their folders exist."""
        self._videos += 1
        number = self._videos - 1
        return {key: self.layout.path(self.root, VIDEO_PATH, number, video_key=key) for key in self._pictures}

    def video_place(self) -> Row:
        """Return the columns that name the latest video files."""
        chunk, file = self.layout.place(self._videos - 1)
        return video_columns(self._pictures, {"chunk_index": chunk, "file_index": file})

    def believe(self, path: Path, digest: str) -> None:
        """Take the hash of a file as known, so that it is not read again."""
        self._hashes[path.relative_to(self.root).as_posix()] = digest

    def add(self, row: Row, table: pa.Table) -> None:
        """Add one episode.

        Args:
            row: its row, already without its old place and with that of its video.
            table: its frames; they are numbered anew.
        """
        place = self._catalog.next_place(row["tasks"][0])
        for key, values in bookkeeping_arrays(row["length"], *place).items():
            position = self._schema.get_field_index(key)
            field = self._schema.field(position)
            table = table.set_column(position, field, pa.array(values, field.type))
        chunk, file = self._data.write(table.cast(self._schema))
        self._catalog.add(row | {"data/chunk_index": chunk, "data/file_index": file})
        self._seeds.append(row["seed"])

    def finish(self, provenance: dict[str, Any], yields: dict[str, int]) -> Manifest:
        """Write the tables and the manifest."""
        self._data.close()
        self._catalog.finish()
        catalog = self._catalog
        hashes = hash_files(self.root, self._hashes)
        manifest = Manifest(catalog.episodes, catalog.frames, hashes, self._seeds, provenance, yields)
        manifest.write(self.root)
        return manifest


def stored_episodes(store: Store) -> Iterator[tuple[Row, pa.Table]]:
    """Yield every episode's row, without its place in the tables, and its frames; each file is read once."""
    path, table, used = Path(), pa.table({}), 0
    for row in store.full_rows():
        if (holder := store.data_path(row)) != path:
            path, table, used = holder, pq.read_table(holder), 0
        yield without_place(row), table.slice(used, row["length"]).combine_chunks()
        used += row["length"]
