"""Second claim: LeRobot reads the dataset, and what it reads follows from the frames."""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from av.error import FFmpegError

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.reading import open_table, read_object, reading
from dynahoi_lerobot.dataset.columns import (
    BOOKKEEPING,
    arrow_schema,
    bookkeeping_arrays,
    numeric_keys,
)
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import (
    CODEBASE_VERSION,
    DATA_PATH,
    INFO_PATH,
    MANIFEST_PATH,
    STATS_PATH,
    VIDEO_PATH,
)
from dynahoi_lerobot.dataset.statistics import Stats, column_stats, image_stats, pooled
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import stored_packets, stream_problem

SAME_S = 1e-6
"""Times that differ by less are the same [s]: tools that append episodes add up times."""
SAME = 1e-9
"""Statistics that differ by less, relatively or absolutely, are the same: another processor adds
in another order."""
IMAGE_LEVELS = {
    "mean": 4,
    "std": 8,
    "q10": 24,
    "q50": 24,
    "q90": 24,
    "q01": 48,
    "q99": 48,
    "min": 96,
    "max": 96,
}
"""How far statistics of images before encoding may lie from those of the decoded images [levels of
255], up to crf ``CRF``. The greatest seen are 1.7, 3.6, 10, 12, 6, 31, 14, 27 and 54: video halves
the resolution of colors."""
CRF = 23
CRF_DOUBLES = 12
"""Beyond ``CRF``, this many steps double the tolerance (seen with crf 51: 7.8 for the mean, 17 for
std)."""


def format_problems(store: Store, note: Callable[[str], object]) -> Iterator[str]:
    """Yield what LeRobot's reader would stumble over, or read otherwise than it was written.

    ``note`` is told in a sentence if LeRobot is not installed.
    """
    yield from _info(store)
    yield from _places(store)
    yield from _bookkeeping(store)
    yield from _videos(store)
    if find_spec("lerobot"):
        yield from _read_by_lerobot(store)
    else:
        note("LeRobot is not installed, so its own reader was not tried")


def _info(store: Store) -> Iterator[str]:
    frames = sum(row["length"] for row in store.rows)
    if store.frame_count != frames:
        yield f"the data files hold {store.frame_count} frames; their episodes have {frames}"
    wanted = {
        "codebase_version": CODEBASE_VERSION,
        "fps": CONTROL_HZ,
        "data_path": DATA_PATH,
        **({"video_path": VIDEO_PATH} if store.video_keys else {}),
        "total_episodes": store.episodes,
        "total_frames": store.frame_count,
        "total_tasks": len(store.tasks),
        "splits": {"train": f"0:{store.episodes}"},
    }
    for key, value in wanted.items():
        found = store.info.get(key)
        if found != value:
            yield f"info.json says {key} is {found!r}; the tables give {value!r}"


def _places(store: Store) -> Iterator[str]:
    """Yield files that the episode table names in vain."""
    for row in store.rows:
        videos = [store.video_path(row, key) for key in store.video_keys]
        for path in [store.data_path(row), *videos]:
            if not path.is_file():
                yield f"{path} of episode {row['episode_index']} is missing"


def _bookkeeping(store: Store) -> Iterator[str]:
    """Yield frames whose numbers, times or instruction are not their episode's."""
    arrays = store.data.columns(list(BOOKKEEPING))
    columns = {key: values[:, 0] for key, values in zip(BOOKKEEPING, arrays, strict=True)}
    numbers = {task: number for number, task in enumerate(store.tasks)}
    for row in store.rows:
        name = f"episode {row['episode_index']}"
        frames = slice(row["dataset_from_index"], row["dataset_to_index"])
        count = len(columns["index"][frames])
        if count != row["length"]:
            yield f"{name} has {count} frames, not {row['length']}"
            continue
        task = numbers.get(row["tasks"][0], -1) if len(row["tasks"]) == 1 else -1
        wanted = bookkeeping_arrays(
            row["length"], row["episode_index"], row["dataset_from_index"], task
        )
        for key, values in wanted.items():
            found = columns[key][frames]
            for frame in np.flatnonzero(found != values)[:1]:
                yield f"{name}, frame {frame}: {key} is {found[frame]}, not {values[frame]}"


def _videos(store: Store) -> Iterator[str]:
    """Yield videos that do not hold exactly their episodes' frames, each from a key frame on."""
    files: dict[tuple[str, Path], list[EpisodeRow]] = {}
    for row in store.rows:
        for key in store.video_keys:
            files.setdefault((key, store.video_path(row, key)), []).append(row)
    for (key, path), rows in files.items():
        name = path.relative_to(store.root)
        try:
            is_key_frame = [packet.is_keyframe for packet in stored_packets(path)]
            problem = stream_problem(path)
        except (OSError, FFmpegError, IndexError, ValueError) as error:
            yield f"{name} cannot be read as a video: {error}"
            continue
        if problem:
            yield f"{name} {problem}"
        start = 0
        for row in rows:
            episode = f"episode {row['episode_index']}"
            stop = start + row["length"]
            said = [row[f"videos/{key}/{end}_timestamp"] for end in ("from", "to")]
            wanted = [start / CONTROL_HZ, stop / CONTROL_HZ]
            if not np.allclose(said, wanted, rtol=0.0, atol=SAME_S):
                yield f"{name} has {episode} at {wanted} s; the episode table says {said}"
            if start < len(is_key_frame) and not is_key_frame[start]:
                yield f"{name} has no key frame at frame {start}, where {episode} begins"
            start = stop
        if len(is_key_frame) != start:
            yield f"{name} holds {len(is_key_frame)} frames; its episodes have {start}"


def _read_by_lerobot(store: Store) -> Iterator[str]:
    """Yield instructions and files of episodes that LeRobot's reader finds elsewhere."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    store.check_files()  # of a file that is missing LeRobot would ask the Hub
    with reading(store.root):
        meta = LeRobotDatasetMetadata(f"local/{store.root.name}", root=store.root)
        tasks = meta.tasks.index.tolist() if meta.tasks is not None else []
    if tasks != store.tasks:
        yield f"LeRobot reads the instructions {tasks!r:.80}; the table holds {store.tasks!r:.80}"
    for row in store.rows:
        index = row["episode_index"]
        paths = {store.data_path(row): meta.get_data_file_path(index)}
        for key in store.video_keys:
            paths[store.video_path(row, key)] = meta.get_video_file_path(index, key)
        for path, found in paths.items():
            if store.root / found != path:
                yield f"LeRobot looks for episode {index} in {found}; it is in {path}"


def column_problems(store: Store) -> Iterator[str]:
    """Yield files of frames whose columns, or the note on them for ``datasets``, are not those that
    ``info.json`` describes.
    """
    described = arrow_schema(store.features)
    for path in store.data.files:
        found = open_table(path).schema_arrow
        if not found.equals(described) or found.metadata != described.metadata:
            names = ", ".join(found.names)
            yield (
                f"{path.relative_to(store.root)} holds other columns or types ({names:.80}) than "
                f"{INFO_PATH} describes"
            )


def statistics_problems(store: Store) -> Iterator[str]:
    """Yield statistics in ``stats.json`` that the frames do not have.

    LeRobot's normalizers read them. Those of columns must be equal; those of images, taken before
    encoding, must be near those of the decoded images.
    """
    said = read_object(store.root / STATS_PATH)
    for key in numeric_keys(store.features):
        values = store.frame_columns([key])[key]
        yield from _other_statistics(key, said.get(key), column_stats(values), {})
    episodes: dict[str, list[Stats]] = {key: [] for key in store.image_keys}
    for stored in store.stored_episodes() if episodes else ():
        for key, found in episodes.items():
            found.append(image_stats(store.images(stored.row, stored.frames, key)))
    doubled = max(0, store.encoding.crf - CRF) / CRF_DOUBLES
    tolerances = {name: levels / 255 * 2**doubled for name, levels in IMAGE_LEVELS.items()}
    for key, found in episodes.items():
        is_video = key in store.video_keys
        yield from _other_statistics(
            key, said.get(key), pooled(found), tolerances if is_video else {}
        )


def _other_statistics(
    key: str, said: object, wanted: Stats, tolerances: dict[str, float]
) -> Iterator[str]:
    """Yield the statistics of a column that are missing or beyond their tolerance."""
    for name, value in wanted.items():
        found = np.asarray(said.get(name) if isinstance(said, dict) else None)
        is_number = found.dtype.kind in "if" and found.shape == value.shape
        tolerance = tolerances.get(name, 0.0) + SAME
        if not is_number or not np.allclose(found, value, rtol=SAME, atol=tolerance):
            told = " ".join(str(found.tolist()).split())
            yield (
                f"{STATS_PATH} says {name} of {key} is {told:.80}; the frames give "
                f"{value.tolist()!s:.80}"
            )


def manifest_problems(store: Store, manifest: Manifest) -> Iterator[str]:
    """Yield counts, seeds and the benchmark where the manifest and the episode table differ."""
    rows = store.rows
    wanted = {
        "episodes": len(rows),
        "frames": sum(row["length"] for row in rows),
        "seeds": [row["seed"] for row in rows],
        "benchmark": ", ".join(sorted({row["benchmark"] for row in rows})),
    }
    if manifest.yields:
        failed = sum(not row["success"] for row in rows)
        wanted["yields"] = manifest.yields | {"kept": len(rows), "failed": failed}
    for name, value in wanted.items():
        found = getattr(manifest, name)
        if found != value:
            yield f"{MANIFEST_PATH} says {name} is {found!s:.80}; the episodes give {value!s:.80}"
