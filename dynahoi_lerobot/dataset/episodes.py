"""Episode <-> LeRobotDataset v3.0: write episodes as a dataset, read a dataset as episodes.

Only ``open_dataset`` needs LeRobot, and imports it when called.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynahoi_lerobot.dataset.codecs.base import Encoding
from dynahoi_lerobot.dataset.files import temporary_sibling
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.episode import Episode

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset


def write_episodes(
    root: Path,
    episodes: Iterable[Episode],
    image_size: int | None,
    encoding: Encoding | None = None,
    views: Sequence[str] = (),
) -> Manifest:
    """Write episodes, in their order, as a new dataset; ``root`` appears when it is whole.

    Args:
        root: a path that does not exist yet.
        episodes: one or more, all with images of the same size or all without.
        image_size: side of the square images [pixels], None for a dataset without a camera.
        encoding: how pictures are stored; H.264 video by default.
        views: pictures that the episodes hold besides the hand's camera.

    Raises:
        FileExistsError: if ``root`` exists.
        ValueError: if there is no episode, or one does not fit the dataset.
    """
    if root.exists():
        raise FileExistsError(f"{root} exists; choose a new folder for the dataset")
    with temporary_sibling(root) as folder:
        writer = DatasetWriter(folder, image_size, encoding, views=views)
        for episode in episodes:
            writer.add(episode)
        return writer.finish()


def read_episodes(root: Path, indices: Iterable[int] | None = None, *, images: bool = True) -> Iterator[Episode]:
    """Yield episodes of a dataset that this project wrote.

    Args:
        root: the dataset's folder.
        indices: which episodes, all by default.
        images: False leaves the pictures undecoded.

    Raises:
        IndexError: if the dataset has no episode of an index.
    """
    store = Store(root)
    for index in range(store.episodes) if indices is None else indices:
        yield store.episode(index, images=images)


def open_dataset(root: Path, **options: Any) -> LeRobotDataset:
    """Open the dataset with LeRobot; ``options`` go to ``LeRobotDataset`` (``delta_timestamps``, ``episodes``)."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset(f"local/{root.name}", root=root, **options)
