"""Merge datasets of ours into one: videos are linked, tables renumbered; no picture is read or encoded again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.generate.catalog import Catalog
from dynahoi_lerobot.generate.features import arrow_schema, bookkeeping_arrays
from dynahoi_lerobot.generate.files import link, temporary_sibling
from dynahoi_lerobot.generate.layout import DATA_PATH, VIDEO_PATH, Layout
from dynahoi_lerobot.generate.manifest import Manifest, hash_files
from dynahoi_lerobot.generate.rows import Row, without_place
from dynahoi_lerobot.generate.store import Store
from dynahoi_lerobot.generate.tables import RollingParquet
from dynahoi_lerobot.spec import CAMERA_KEY


def merge(
    sources: Sequence[Path],
    root: Path,
    *,
    layout: Layout | None = None,
    provenance: dict[str, Any] | None = None,
) -> Manifest:
    """Merge datasets, in the given order, into a new one; ``root`` appears when it is whole.

    Args:
        sources: folders of datasets written by this project.
        root: a path that does not exist yet.
        layout: file size limits.
        provenance: what the manifest shall say about the dataset's origin.

    Raises:
        FileExistsError: if ``root`` exists.
        ValueError: if the datasets' features differ, or there are none.
    """
    if root.exists():
        raise FileExistsError(f"{root} exists; choose a new folder for the merged dataset")
    stores = [Store(source) for source in sources]
    if not stores:
        raise ValueError("there is nothing to merge; name one dataset or more")
    for store in stores[1:]:
        if store.features != stores[0].features:
            raise ValueError(f"{store.root} has other features than {stores[0].root}; merge like with like")
    with temporary_sibling(root) as folder:
        folder.mkdir()
        merger = _Merger(folder, stores[0], layout or Layout())
        for store in stores:
            merger.append(store)
        return merger.finish(provenance or {})


class _Merger:
    """The growing dataset."""

    def __init__(self, root: Path, like: Store, layout: Layout) -> None:
        self._root, self._layout = root, layout
        self._schema = arrow_schema(like.features)
        self._catalog = Catalog(root, like.features, layout)
        self._data = RollingParquet(root, DATA_PATH, self._schema, layout)
        self._videos = 0
        self._known: dict[str, str] = {}
        self._histogram: np.ndarray | None = None
        self._seeds: list[int] = []
        self._yields: Counter[str] = Counter()

    def append(self, store: Store) -> None:
        """Add all episodes of a dataset."""
        manifest = Manifest.read(store.root)
        places: dict[Path, tuple[int, int]] = {}
        tables = _EpisodeTables(store)
        for placed in store.full_rows():
            row = without_place(placed)
            if store.has_video:
                row.update(self._link_video(store.video_path(row), store.root, places, manifest))
            row.update(self._copy_frames(tables.next(row), row))
            self._catalog.add(row)
        if manifest.histogram is not None:
            before = 0 if self._histogram is None else self._histogram
            self._histogram = before + manifest.histogram
        self._seeds += manifest.seeds
        self._yields.update(manifest.yields)

    def finish(self, provenance: dict[str, Any]) -> Manifest:
        """Write the tables and the manifest."""
        self._data.close()
        self._catalog.finish(self._histogram)
        manifest = Manifest(
            self._catalog.episodes,
            self._catalog.frames,
            hash_files(self._root, self._known),
            [] if self._histogram is None else self._histogram.tolist(),
            self._seeds,
            provenance,
            dict(self._yields),
        )
        manifest.write(self._root)
        return manifest

    def _link_video(
        self, source: Path, source_root: Path, places: dict[Path, tuple[int, int]], manifest: Manifest
    ) -> Row:
        if source not in places:
            target = self._layout.path(self._root, VIDEO_PATH, self._videos, video_key=CAMERA_KEY)
            link(source, target)
            known = manifest.files[source.relative_to(source_root).as_posix()]
            self._known[target.relative_to(self._root).as_posix()] = known
            places[source] = self._layout.place(self._videos)
            self._videos += 1
        chunk, file = places[source]
        return {f"videos/{CAMERA_KEY}/chunk_index": chunk, f"videos/{CAMERA_KEY}/file_index": file}

    def _copy_frames(self, table: pa.Table, row: Row) -> Row:
        place = self._catalog.next_place(row["tasks"][0])
        for key, values in bookkeeping_arrays(row["length"], *place).items():
            position = self._schema.get_field_index(key)
            field = self._schema.field(position)
            table = table.set_column(position, field, pa.array(values, field.type))
        chunk, file = self._data.write(table.cast(self._schema))
        return {"data/chunk_index": chunk, "data/file_index": file}


class _EpisodeTables:
    """Hands out a dataset's frame table episode by episode, reading each file once."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._path: Path | None = None
        self._table = pa.table({})
        self._used = 0

    def next(self, row: Row) -> pa.Table:
        """Return the rows of the next episode."""
        path = self._store.data_path(row)
        if path != self._path:
            self._path, self._table, self._used = path, pq.read_table(path), 0
        part = self._table.slice(self._used, row["length"])
        self._used += row["length"]
        return part.combine_chunks()
