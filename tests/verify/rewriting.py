"""Changes to a dataset as a forger makes them: files, statistics and hashes agree afterwards."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset.columns import dataset_features
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.dataset.writer import DatasetWriter


def sign(root: Path) -> None:
    """Let the manifest promise what is there."""
    dataclasses.replace(Manifest.read(root), files=hash_files(root)).write(root)


def rewrite(root: Path, episodes: list[Episode], encoding: Encoding | None = None) -> None:
    """Put other episodes into a dataset's place, with its manifest's promises about where they come from."""
    manifest = Manifest.read(root)
    shutil.rmtree(root)
    writer = DatasetWriter.for_episodes(root, dataset_features(episodes[0]), encoding)
    for episode in episodes:
        writer.add(episode)
    writer.finish(manifest.provenance, manifest.yields)


def changed(name: str, where: object, value: object) -> Callable[[Episode], Episode]:
    """Return what sets a part of an array, or adds to it where ``value`` is a function."""

    def change(episode: Episode) -> Episode:
        array = getattr(episode, name).copy()
        array[where] = value(array[where]) if callable(value) else value
        return dataclasses.replace(episode, **{name: array})

    return change
