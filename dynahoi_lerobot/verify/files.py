"""First claim: the files are the ones that were made, or another tool has edited them and LeRobot
reads them.

Of an edited dataset only LeRobot's format is checked: what we add to it is gone or stale.
"""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from dynahoi_lerobot.core.reading import ReadError, read_object, read_table
from dynahoi_lerobot.dataset.episode_table import FACTS
from dynahoi_lerobot.dataset.manifest import Manifest, changed_files, structure_problems
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH, STATS_PATH, check_root
from dynahoi_lerobot.dataset.store import Store, frame_column

TOOL = "another tool, such as lerobot-edit-dataset, has edited this dataset"
ACTION = "action"
OUTSIDE = 0.03
"""Share of an action's numbers that may lie outside its quantiles."""
ROUNDING = 1e-6
"""A number that lies outside by less is not counted."""
SHOWN = 4
"""Files that a sentence names."""


def unreadable(store: Store) -> Iterator[str]:
    """Yield a sentence for each table that cannot be read; without them nothing else can be
    checked.
    """
    for path in store.tables():
        try:
            read_table(path)
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
    """Return a sentence if another tool has rewritten files, or removed the manifest if there is
    none, else None.
    """
    if manifest is None:
        told = _gone(store)
    else:
        changed = changed_files(store.root, manifest)
        if not changed:
            return None
        more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        has = "has" if len(changed) == 1 else "have"
        told = f"{', '.join(changed[:SHOWN])}{more} {has} changed since {MANIFEST_PATH} was written"
    return (
        f"edited: {told}: {TOOL}, so only LeRobot's format can be checked{_averaged(store)}; "
        f"`dynahoi filter` drops episodes and keeps everything of the others"
    )


def _gone(store: Store) -> str:
    """Say what another tool has dropped beside the manifest."""
    held = store.episode_table.names()
    lost = [name for name in FACTS if name not in held]
    has_privileged = bool(store.privileged.features)
    gone = [MANIFEST_PATH]
    if not has_privileged:
        gone.append("the privileged tables")
    if lost:
        gone.append(f"our columns of the episode table ({', '.join(lost[:3])}, ...)")
    told = f"{' and '.join(gone)} {'are' if len(gone) > 1 else 'is'} gone"
    if has_privileged and store.privileged.problem:
        told += ", and the privileged tables are those of other episodes"
    return told


def _averaged(store: Store) -> str:
    """Return what to add if the quantiles of the actions are not those of the actions: LeRobot's
    tools average the quantiles of episodes.
    """
    with suppress(ReadError, TypeError, ValueError, KeyError):
        told = read_object(store.root / STATS_PATH)[ACTION]
        low = np.asarray(told["q01"], float)
        high = np.asarray(told["q99"], float)
        values = frame_column(store.root, ACTION).astype(float)
        outside = float(np.mean((values < low - ROUNDING) | (values > high + ROUNDING)))
        if outside > OUTSIDE:
            return (
                f", and {outside:.0%} of the numbers in {ACTION!r} lie outside q01 to q99 of "
                f"{STATS_PATH}, where 2 % should: LeRobot averaged the quantiles of episodes"
            )
    return ""
