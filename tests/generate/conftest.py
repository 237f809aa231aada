from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import av.logging
import numpy as np
import pytest

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.generate.writer import DatasetWriter
from tests.synthetic import synthetic_episode

av.logging.set_level(av.logging.ERROR)


def varied_episode(seed: int, image_size: int | None = 32) -> Episode:
    """A synthetic episode whose length, task and pictures depend on its seed."""
    episode = synthetic_episode(seed, frames=20 + seed % 7, image_size=image_size)
    meta = dataclasses.replace(episode.meta, task=f"Catch the {('red', 'blue')[seed % 2]} ball.")
    images = episode.images
    if images is not None:
        images = images + np.uint8(seed % 5)
        images[:, :4, :4] = np.random.default_rng(seed).integers(0, 255, (4, 4, 3), np.uint8)
    return dataclasses.replace(episode, meta=meta, images=images)


def write(root: Path, seeds: range | list[int], image_size: int | None = 32, **options) -> Path:
    writer = DatasetWriter(root, image_size, **options)
    for seed in seeds:
        writer.add(varied_episode(seed, image_size))
    writer.finish()
    return root


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Six episodes with video; tests must not change it."""
    return write(tmp_path_factory.mktemp("ours") / "dataset", range(6))
