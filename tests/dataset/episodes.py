"""Episodes and small datasets for tests without a simulator, and changes to them as a forger makes
them.

Worker processes import this, so it stays light.
"""

import dataclasses
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset.columns import dataset_features
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.dataset.writer import DatasetWriter
from tests.synthetic import synthetic_episode


def varied_episode(seed: int, image_size: int = 32, views: Sequence[str] = ()) -> Episode:
    """A synthetic episode whose length, task and images depend on its seed."""
    episode = synthetic_episode(seed, frames=20 + seed % 7, image_size=image_size)
    meta = dataclasses.replace(episode.meta, task=f"Catch the {('red', 'blue')[seed % 2]} ball.")
    images = {}
    if image_size:
        ego = episode.images["ego"] + np.uint8(seed % 5)
        ego[:, :4, :4] = np.random.default_rng(seed).integers(0, 255, (4, 4, 3), np.uint8)
        images = {"ego": ego} | {view: ego[:, ::-1] // (2 + n) for n, view in enumerate(views)}
    return dataclasses.replace(episode, meta=meta, images=images)


def write(
    root: Path, seeds: range | list[int], image_size: int = 32, views: Sequence[str] = (), **options
) -> Path:
    """Write the varied episodes of ``seeds`` as a dataset; ``options`` go to ``DatasetWriter``."""
    written(root, [varied_episode(seed, image_size, views) for seed in seeds], **options).finish()
    return root


def written(root: Path, episodes: Sequence[Episode], **options) -> DatasetWriter:
    """Return the writer of a dataset that has all of its episodes and is not finished."""
    writer = DatasetWriter(root, dataset_features(episodes[0]), **options)
    for episode in episodes:
        writer.add(episode)
    return writer


def sign(root: Path) -> None:
    """Let the manifest promise what is there."""
    dataclasses.replace(Manifest.read(root), files=hash_files(root)).write(root)


def rewrite(root: Path, episodes: list[Episode], encoding: Encoding | None = None) -> None:
    """Put other episodes into a dataset's place, with its manifest's promises about where they come
    from.
    """
    manifest = Manifest.read(root)
    shutil.rmtree(root)
    writer = written(root, episodes, encoding=encoding)
    writer.finish(manifest.provenance, manifest.yields)


def changed(name: str, where: object, value: object) -> Callable[[Episode], Episode]:
    """Return what sets a part of an array, or adds to it where ``value`` is a function."""

    def change(episode: Episode) -> Episode:
        array = getattr(episode, name).copy()
        array[where] = value(array[where]) if callable(value) else value
        return dataclasses.replace(episode, **{name: array})

    return change
