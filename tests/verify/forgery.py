"""Changes to a dataset as a careful forger makes them: statistics, totals and hashes agree afterwards."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynahoi_lerobot.core.features import CAMERA_KEY
from dynahoi_lerobot.dataset.assembly import Assembly, stored_episodes
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.dataset.columns import column_array, content_keys
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, stats_columns, video_columns
from dynahoi_lerobot.dataset.files import link
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.statistics import table_stats
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import VideoWriter, decode

DATA = "data/chunk-000/file-000.parquet"
ROWS = "meta/episodes/chunk-000/file-000.parquet"
TASKS, INFO, MANIFEST = "meta/tasks.parquet", "meta/info.json", "meta/manifest.json"
VIDEO = f"videos/{CAMERA_KEY}/chunk-000/file-000.mp4"
OTHER_VIDEO = f"videos/{CAMERA_KEY}/chunk-000/file-001.mp4"

Damage = Callable[[Path], object]
Columns = dict[str, np.ndarray]
Table = dict[str, tuple[Damage, str, str]]
"""By name: the damage, the mode that finds it, and words of the finding."""


@contextmanager
def changed_column(root: Path, key: str, change: Callable[[pa.ChunkedArray], pa.Array]) -> Iterator[None]:
    """Hold another column ``key`` in a dataset's first data file, signed, and put the file back at the end."""
    path = root / DATA
    whole, table = path.read_bytes(), pq.read_table(path)
    pq.write_table(table.set_column(table.column_names.index(key), key, change(table[key])), path)
    sign(root)
    try:
        yield
    finally:
        path.write_bytes(whole)
        sign(root)


def sign(root: Path) -> None:
    """Let the manifest promise what is there, so that the hashes agree; leave one that cannot be read."""
    with suppress(OSError, ValueError):
        replace(Manifest.read(root), files=hash_files(root)).write(root)


def forge(change: Callable[[EpisodeRow, Columns], object], episode: int = 0) -> Damage:
    """Return a damage that changes one episode's row and columns (T, D), with all that follows from them."""

    def apply(root: Path) -> None:
        def changed(index: int, row: EpisodeRow, columns: Columns) -> None:
            if index == episode:
                change(row, columns)

        rebuild(root, changed)

    return apply


def rebuild(
    root: Path, change: Callable[[int, EpisodeRow, Columns], object], order: Sequence[int] | None = None
) -> None:
    """Write the tables again with changed episodes, in another order or without some; videos stay as they are."""
    store, manifest, folder = Store(root), Manifest.read(root), root.with_name("forged")
    assembly, sources = Assembly(folder, store, FileLimits()), []
    episodes = list(stored_episodes(store))
    for index in order if order is not None else range(len(episodes)):
        row, table = episodes[index]
        columns = {key: column_array(table, key).copy() for key in content_keys(store.features)}
        change(index, row, columns)
        for key, values in columns.items():
            position, field = table.schema.get_field_index(key), table.schema.field(key)
            cells = [cell if len(cell) > 1 else cell[0] for cell in values.tolist()]
            table = table.set_column(position, field, pa.array(cells, field.type))
        if (source := store.video_path(row, CAMERA_KEY)) not in sources:
            sources.append(source)
            link(source, assembly.next_videos()[CAMERA_KEY])
        place = {"chunk_index": 0, "file_index": sources.index(source)}
        assembly.add(row | stats_columns(table_stats(columns)) | video_columns([CAMERA_KEY], place), table)
    assembly.finish(manifest.provenance, manifest.yields)
    shutil.rmtree(root)
    folder.rename(root)


def at(key: str, where: Any, value: Any) -> Damage:
    """Return a forgery of episode 0: ``columns[key][where] = value``, or plus it where it is a function."""

    def change(row: EpisodeRow, columns: Columns) -> None:
        columns[key][where] = value(columns[key][where]) if callable(value) else value

    return forge(change)


def row_is(episode: int = 0, **values: Any) -> Damage:
    """Return a forgery that sets columns of an episode's row; a task goes into all its places."""
    tasks = {"tasks": [values["task"]]} if "task" in values else {}
    return forge(lambda row, columns: row.update(values | tasks), episode)


def entry(name: str, change: Callable[[dict], object]) -> Damage:
    """Return a damage that changes the content of a JSON file."""

    def apply(root: Path) -> None:
        content = json.loads((root / name).read_text())
        change(content)
        (root / name).write_text(json.dumps(content))

    return apply


def table(name: str, change: Callable[[pa.Table], pa.Table]) -> Damage:
    """Return a damage that writes a changed parquet table."""
    return lambda root: pq.write_table(change(pq.read_table(root / name)), root / name)


def cell(name: str, column: str, number: int, change: Callable) -> Damage:
    """Return a damage that changes one cell of a table and nothing else."""

    def changed(old: pa.Table) -> pa.Table:
        cells = old[column].to_pylist()
        cells[number] = change(cells[number])
        return with_column(old, column, pa.array(cells, old.schema.field(column).type))

    return table(name, changed)


def with_column(old: pa.Table, name: str, values: pa.Array) -> pa.Table:
    """Return the table with a column replaced, in the type of ``values``."""
    position = old.schema.get_field_index(name)
    return old.set_column(position, pa.field(name, values.type), values)


def file(name: str, change: Callable[[bytes], bytes]) -> Damage:
    """Return a damage to the bytes of a file."""
    return lambda root: (root / name).write_bytes(change((root / name).read_bytes()))


def half(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flip(share: float) -> Callable[[bytes], bytes]:
    """Return what flips all bits of one byte at a share of the length."""
    return lambda c: c[: (at := int(len(c) * share))] + bytes([c[at] ^ 255]) + c[at + 1 :]


def pictures(change: Callable[[list], list], fps: int = 20, name: str = VIDEO, cut: bool = True) -> Damage:
    """Return a damage that encodes a video again from changed pictures, with a key frame at each episode's start."""

    def apply(root: Path) -> None:
        lengths = [row["length"] for row in Store(root).rows if Store(root).video_path(row, CAMERA_KEY) == root / name]
        frames = change(list(decode(root / name)))
        (root / name).unlink()
        writer = VideoWriter(root / name, frames[0].shape[0], fps, Encoding())
        for part in np.split(np.stack(frames), np.cumsum(lengths)[:-1]) if cut else [np.stack(frames)]:
            writer.write(part)
        writer.close()

    return apply


def swap(one: str, other: str) -> Damage:
    """Return a damage that exchanges two files."""

    def apply(root: Path) -> None:
        first, second = (root / one).read_bytes(), (root / other).read_bytes()
        (root / one).write_bytes(second)
        (root / other).write_bytes(first)

    return apply


def folder_instead(name: str) -> Damage:
    """Return a damage that puts a folder in a file's place."""

    def apply(root: Path) -> None:
        (root / name).unlink()
        (root / name).mkdir()

    return apply


def entry_of(column: str, number: int, change: Callable[[float], float]) -> Damage:
    """Return a forgery of one number of episode 0's ``stats/<column>``."""

    def changed(row: EpisodeRow, columns: Columns) -> None:
        values = row[f"stats/{column}"]
        values[number] = change(values[number])

    return forge(changed)


def info(**values: Any) -> Damage:
    """Return a damage to entries of ``info.json``."""
    return entry(INFO, lambda content: content.update(values))


def plan(**values: Any) -> Damage:
    """Return a damage to entries of the manifest's plan."""
    return entry(MANIFEST, lambda m: m["provenance"].update(values))


def kept(*order: int) -> Damage:
    """Return a forgery that keeps these episodes, in this order."""
    return lambda root: rebuild(root, lambda index, row, columns: None, order)
