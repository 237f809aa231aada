"""First claim: the files are the ones that were made, or another tool has edited them and LeRobot
reads them.

Of an edited dataset only LeRobot's format is checked: what we add to it is gone or stale.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from av.error import FFmpegError

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.reading import ReadError, open_table, read_object
from dynahoi_lerobot.dataset.columns import BOOKKEEPING, bookkeeping_arrays, column_array
from dynahoi_lerobot.dataset.episode_table import FACTS, EpisodeRow
from dynahoi_lerobot.dataset.manifest import Manifest, changed_files, structure_problems
from dynahoi_lerobot.dataset.paths import (
    CODEBASE_VERSION,
    DATA_PATH,
    MANIFEST_PATH,
    STATS_PATH,
    VIDEO_PATH,
    check_root,
)
from dynahoi_lerobot.dataset.store import Store, frame_column
from dynahoi_lerobot.dataset.video import stored_packets, stream_problem

TOOL = "another tool, such as lerobot-edit-dataset, has edited this dataset"
ACTION = "action"
OUTSIDE, ROUNDING = 0.03, 1e-6
"""Share of an action's numbers that may lie outside its quantiles, and by how much they may without
being counted."""
SHOWN = 4
"""Files that a sentence names."""
EXACT_S = 1e-6
"""Times that differ by less are the same [s]: tools that append episodes add up times."""


def unreadable(store: Store) -> Iterator[str]:
    """Yield a sentence for each table that cannot be read; without them nothing else can be
    checked.
    """
    for path in store.tables():
        try:
            store.table(path)
        except ReadError as error:
            yield str(error)


def file_problems(store: Store, manifest: Manifest | None) -> Iterator[str]:
    """Yield why LeRobot cannot open the folder, and files that are missing or not in the manifest,
    if there is one.
    """
    try:
        check_root(store.root)
    except ValueError as error:
        yield str(error)
    if manifest is not None:
        yield from structure_problems(store.root, manifest)


def edited(store: Store, manifest: Manifest | None) -> str | None:
    """Return a sentence if another tool has rewritten files, and removed the manifest if there is
    none, else None.
    """
    if manifest is None:
        held = {name for path in store.row_files() for name in open_table(path).schema_arrow.names}
        lost = [name for name in FACTS if name not in held]
        gone = [MANIFEST_PATH]
        gone += [] if any(store.privileged.files()) else ["the privileged tables"]
        gone += [f"our columns of the episode table ({', '.join(lost[:3])}, ...)"] if lost else []
        told = f"{' and '.join(gone)} {'are' if len(gone) > 1 else 'is'} gone"
        if any(store.privileged.files()) and store.privileged.problem:
            told += ", and the privileged tables are those of other episodes"
    elif changed := changed_files(store.root, manifest):
        more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        has = "has" if len(changed) == 1 else "have"
        told = f"{', '.join(changed[:SHOWN])}{more} {has} changed since {MANIFEST_PATH} was written"
    else:
        return None
    return (
        f"edited: {told}: {TOOL}, so only LeRobot's format can be checked{_averaged(store)}; "
        f"`dynahoi filter` drops episodes and keeps everything of the others"
    )


def _averaged(store: Store) -> str:
    """Return what to add if the quantiles of the actions are not those of the actions: LeRobot's
    tools average the quantiles of episodes.
    """
    with suppress(ReadError, TypeError, ValueError, KeyError):
        told = read_object(store.root / STATS_PATH)[ACTION]
        low, high = (np.asarray(told[name], float) for name in ("q01", "q99"))
        values = frame_column(store.root, ACTION).astype(float)
        outside = float(np.mean((values < low - ROUNDING) | (values > high + ROUNDING)))
        if outside > OUTSIDE:
            return (
                f", and {outside:.0%} of the numbers in {ACTION!r} lie outside q01 to q99 of "
                f"{STATS_PATH}, where 2 % should: LeRobot averaged the quantiles of episodes"
            )
    return ""


def format_problems(store: Store) -> Iterator[str]:
    """Yield what LeRobot's reader would stumble over, or read otherwise than it was written."""
    yield from _info(store)
    yield from _places(store)
    yield from _bookkeeping(store)
    yield from video_problems(store)


def _info(store: Store) -> Iterator[str]:
    frames = sum(open_table(path).metadata.num_rows for path in store.data_files())
    if frames != (told := sum(row["length"] for row in store.rows)):
        yield f"the data files hold {frames} frames; their episodes have {told}"
    wanted = {
        "codebase_version": CODEBASE_VERSION,
        "fps": CONTROL_HZ,
        "data_path": DATA_PATH,
        **({"video_path": VIDEO_PATH} if store.video_keys else {}),
        "total_episodes": store.episodes,
        "total_frames": frames,
        "total_tasks": len(store.tasks),
        "splits": {"train": f"0:{store.episodes}"},
    }
    for key, value in wanted.items():
        if (found := store.info.get(key)) != value:
            yield f"info.json says {key} is {found!r}; the tables give {value!r}"


def _places(store: Store) -> Iterator[str]:
    """Yield files that the episode table names in vain."""
    for row in store.rows:
        files = [
            store.data_path(row),
            *(store.video_path(row, key) for key in store.video_keys),
        ]
        yield from (
            f"{path} of episode {row['episode_index']} is missing"
            for path in files
            if not path.is_file()
        )


def _bookkeeping(store: Store) -> Iterator[str]:
    """Yield frames whose numbers, times or instruction are not their episode's."""
    tables = [store.table(path, list(BOOKKEEPING)) for path in store.data_files()]
    columns = {
        key: np.concatenate([column_array(table, key)[:, 0] for table in tables])
        for key in BOOKKEEPING
    }
    done = 0
    for row in store.rows:
        name, part = f"episode {row['episode_index']}", slice(done, done := done + row["length"])
        if (count := len(columns["index"][part])) != row["length"]:
            yield f"{name} has {count} frames, not {row['length']}"
            continue
        task = (
            store.tasks.index(row["tasks"][0])
            if len(row["tasks"]) == 1 and row["tasks"][0] in store.tasks
            else -1
        )
        wanted = bookkeeping_arrays(
            row["length"], row["episode_index"], row["dataset_from_index"], task
        )
        for key, values in wanted.items():
            found = columns[key][part]
            if (wrong := np.flatnonzero(found != values)).size:
                frame = int(wrong[0])
                yield f"{name}, frame {frame}: {key} is {found[frame]}, not {values[frame]}"


def video_problems(store: Store) -> Iterator[str]:
    """Yield videos that do not hold exactly their episodes' frames, each from a key frame on."""
    files: dict[tuple[str, Path], list[EpisodeRow]] = {}
    for row in store.rows:
        for key in store.video_keys:
            files.setdefault((key, store.video_path(row, key)), []).append(row)
    for (key, path), rows in files.items():
        name, start = path.relative_to(store.root), 0
        try:
            keyed = [packet.is_keyframe for packet in stored_packets(path)]
            if problem := stream_problem(path):
                yield f"{name} {problem}"
        except (OSError, FFmpegError, IndexError, ValueError) as error:
            yield f"{name} cannot be read as a video: {error}"
            continue
        for row in rows:
            said = [row[f"videos/{key}/{end}_timestamp"] for end in ("from", "to")]
            wanted = [start / CONTROL_HZ, (start + row["length"]) / CONTROL_HZ]
            if not np.allclose(said, wanted, rtol=0.0, atol=EXACT_S):
                yield (
                    f"{name} has episode {row['episode_index']} at {wanted} s; the episode "
                    f"table says {said}"
                )
            if not all(keyed[start : start + 1]):
                yield (
                    f"{name} has no key frame at frame {start}, where episode "
                    f"{row['episode_index']} begins"
                )
            start += row["length"]
        if len(keyed) != start:
            yield f"{name} holds {len(keyed)} frames; its episodes have {start}"
