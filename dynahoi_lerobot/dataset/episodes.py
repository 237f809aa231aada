"""Episode <-> LeRobotDataset v3.0: write episodes as a dataset, read a dataset as episodes.

Only ``open_dataset`` needs LeRobot, and imports it when called.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.dataset.columns import dataset_features
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.dataset.writer import DatasetWriter

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset


def write_episodes(root: Path, episodes: Iterable[Episode], encoding: Encoding | None = None) -> Manifest:
    """Write episodes, in their order, as a new dataset; ``root`` appears atomically.

    The first episode determines the columns: its views and their size, and whether it has ``touch``.

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
    if (first := next(remaining, None)) is None:
        raise ValueError("got no episodes; a dataset needs at least one")
    with new_folder(root) as folder, DatasetWriter.for_episodes(folder, dataset_features(first), encoding) as writer:
        for episode in chain([first], remaining):
            writer.add(episode)
        return writer.finish()


def read_episodes(root: Path, indices: Iterable[int] | None = None, *, images: bool = True) -> Iterator[Episode]:
    """Yield episodes of a dataset that this project wrote.

    Args:
        root: the dataset's folder.
        indices: which episodes, all by default.
        images: False leaves the images undecoded; episodes then have none.

    Raises:
        IndexError: if the dataset has no episode of an index.
    """
    store = Store(root)
    if indices is None:
        for row, table in store.stored_episodes():
            yield store.as_episode(row, table, images=images)
    for index in indices or ():
        yield store.episode(index, images=images)


def open_dataset(root: Path, **options: Any) -> LeRobotDataset:
    """Open the dataset with LeRobot; ``options`` go to ``LeRobotDataset`` (``delta_timestamps``, ``episodes``)."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset(f"local/{root.name}", root=root, **options)
