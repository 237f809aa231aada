from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av.logging
import pytest

from dynahoi_lerobot.dataset.writer import DatasetWriter
from tests.generate.episodes import varied_episode

av.logging.set_level(av.logging.ERROR)


def write(root: Path, seeds: range | list[int], image_size: int | None = 32, **options) -> Path:
    writer = DatasetWriter(root, image_size, **options)
    for seed in seeds:
        writer.add(varied_episode(seed, image_size, options.get("views", ())))
    writer.finish()
    return root


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Six episodes with video; tests must not change it."""
    return write(tmp_path_factory.mktemp("ours") / "dataset", range(6))
