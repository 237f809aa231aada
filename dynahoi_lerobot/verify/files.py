"""First claim: the files are the ones that were made, and LeRobot can read them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from av.error import FFmpegError

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.dataset.columns import BOOKKEEPING, arrow_schema, bookkeeping_arrays, column_array
from dynahoi_lerobot.dataset.episode_table import FACTS, EpisodeRow
from dynahoi_lerobot.dataset.manifest import Manifest, file_problems
from dynahoi_lerobot.dataset.paths import CODEBASE_VERSION, MANIFEST_PATH, TASKS_PATH
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import stored_packets

EXACT_S = 1e-6
"""Times that differ by less are the same [s]: tools that append episodes add up times."""


def manifest_problems(store: Store) -> Iterator[str]:
    """Yield files that are not those of the manifest, and what its counts and seeds say otherwise than the tables."""
    manifest = Manifest.read(store.root)
    yield from file_problems(store.root, manifest)
    facts = {
        "episodes": (manifest.episodes, store.episodes),
        "frames": (manifest.frames, sum(row["length"] for row in store.rows)),
        "seeds": (manifest.seeds, [row["seed"] for row in store.rows]),
        "benchmark": (manifest.benchmark, ", ".join(sorted({row["benchmark"] for row in store.rows}))),
    }
    for name, (said, found) in facts.items():
        if said != found:
            yield f"{MANIFEST_PATH} has other {name} than the episode table: {_short(said)}, not {_short(found)}"


def rewritten(store: Store) -> str | None:
    """Return a sentence if another tool has rewritten the dataset and dropped what only we write, else None."""
    if (store.root / MANIFEST_PATH).exists():
        return None
    held = {name for path in store.row_files() for name in pq.read_schema(path).names}
    lost = [name for name in FACTS if name not in held]
    columns = f", and so are our columns of the episode table ({', '.join(lost[:3])}, ...)" if lost else ""
    return (
        f"{MANIFEST_PATH} is gone{columns}: another tool, such as lerobot-edit-dataset, has written this dataset, so "
        "only LeRobot's format can be checked; `dynahoi filter` copies episodes with everything"
    )


def format_problems(store: Store) -> Iterator[str]:
    """Yield what LeRobot's reader would stumble over, or read otherwise than it was written."""
    yield from _info(store)
    yield from _schema(store)
    yield from _places(store)
    yield from _bookkeeping(store)
    for key in store.image_keys if store.has_video else []:
        yield from _videos(store, key)


def _info(store: Store) -> Iterator[str]:
    frames = sum(pq.read_metadata(path).num_rows for path in store.data_files())
    if frames != (told := sum(row["length"] for row in store.rows)):
        yield f"the data files hold {frames} frames; their episodes have {told}"
    wanted = {
        "codebase_version": CODEBASE_VERSION,
        "fps": CONTROL_HZ,
        "total_episodes": store.episodes,
        "total_frames": frames,
        "total_tasks": len(store.tasks),
        "splits": {"train": f"0:{store.episodes}"},
    }
    for key, value in wanted.items():
        if (found := store.info.get(key)) != value:
            yield f"info.json says {key} is {found!r}; the tables give {value!r}"


def _schema(store: Store) -> Iterator[str]:
    """Yield columns that a data file lacks, or has in another type than its feature."""
    wanted = arrow_schema(store.features)
    for path in store.data_files():
        name, found = path.relative_to(store.root), pq.read_schema(path)
        if found.names != wanted.names:
            yield f"{name} has the columns {_short(found.names)}; info.json has {_short(wanted.names)}"
            continue
        for field in wanted:
            if not _alike(kind := found.field(field.name).type, field.type):
                yield f"{name} holds {field.name} as {kind}; by info.json it is {field.type}"


def _alike(one: pa.DataType, other: pa.DataType) -> bool:
    """Tell whether two types of a column agree: tools write lists with or without a fixed size."""
    lists = all(pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) for kind in (one, other))
    return one == other or (lists and one.value_type == other.value_type)


def _places(store: Store) -> Iterator[str]:
    """Yield rows of the episode table that do not follow each other, and files that they name in vain."""
    start = 0
    for position, row in enumerate(store.rows):
        if row["episode_index"] != position:
            yield f"row {position} of the episode table is numbered {row['episode_index']}"
        span = (row["dataset_from_index"], row["dataset_to_index"])
        if span != (start, start + row["length"]):
            yield f"episode {position} spans frames {span}; {(start, start + row['length'])} follows"
        start = span[1]
        files = [store.data_path(row), *(store.video_path(row, key) for key in store.image_keys if store.has_video)]
        yield from (f"episode {position} lies in {path}, which is missing" for path in files if not path.is_file())


def _bookkeeping(store: Store) -> Iterator[str]:
    """Yield frames whose numbers, times or instruction are not their episode's."""
    tables = [store.table(path, list(BOOKKEEPING)) for path in store.data_files()]
    columns = {key: np.concatenate([column_array(table, key)[:, 0] for table in tables]) for key in BOOKKEEPING}
    done = 0
    for row in store.rows:
        name, part = f"episode {row['episode_index']}", slice(done, done := done + row["length"])
        if (count := len(columns["index"][part])) != row["length"]:
            yield f"{name} has {count} frames, not {row['length']}"
            continue
        text = row["tasks"][0] if len(row["tasks"]) == 1 else None
        task = store.tasks.index(text) if text in store.tasks else -1
        if row.get("task", text) != text or text is None:
            yield f"{name} has the instructions {row['tasks']}; it was told {row.get('task')!r}"
        wanted = bookkeeping_arrays(row["length"], row["episode_index"], row["dataset_from_index"], task)
        for key, values in wanted.items():
            found = columns[key][part]
            if (wrong := np.flatnonzero(found != values)).size:
                frame = int(wrong[0])
                yield f"{name}, frame {frame}: {key} is {found[frame]}, not {values[frame]}"


def _videos(store: Store, key: str) -> Iterator[str]:
    """Yield files of a view that do not hold exactly their episodes' frames, each from a key frame on."""
    files: dict[Path, list[EpisodeRow]] = {}
    for row in store.rows:
        files.setdefault(store.video_path(row, key), []).append(row)
    for path, rows in files.items():
        name, start = path.relative_to(store.root), 0
        try:
            keyed = [packet.is_keyframe for packet in stored_packets(path)]
        except (OSError, FFmpegError, IndexError, ValueError) as error:
            yield f"{name} cannot be read as a video: {error}"
            continue
        for row in rows:
            said = [row[f"videos/{key}/{end}_timestamp"] for end in ("from", "to")]
            wanted = [start / CONTROL_HZ, (start + row["length"]) / CONTROL_HZ]
            if not np.allclose(said, wanted, rtol=0.0, atol=EXACT_S):
                yield f"{name} has episode {row['episode_index']} at {wanted} s; the episode table says {said}"
            if not all(keyed[start : start + 1]):
                yield f"{name} has no key frame at frame {start}, where episode {row['episode_index']} begins"
            start += row["length"]
        if len(keyed) != start:
            yield f"{name} holds {len(keyed)} frames; its episodes have {start}"


def tables_readable(store: Store) -> Iterator[str]:
    """Yield a sentence for each table that cannot be read; without them nothing else can be checked."""
    for path in (store.root / TASKS_PATH, *store.row_files(), *store.data_files()):
        try:
            store.table(path)
        except (ValueError, pa.ArrowException) as error:
            yield str(error)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
