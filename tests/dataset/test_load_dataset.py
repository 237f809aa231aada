"""``datasets`` reads a dataset's folder as typed columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.columns import dataset_features
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.dataset.writer import DatasetWriter
from tests.dataset.episodes import varied_episode


@pytest.mark.parametrize("codec", ["h264", "images"])
def test_columns_have_types_and_shapes(codec: str, tmp_path: Path):
    datasets = pytest.importorskip("datasets")
    writer = DatasetWriter.for_episodes(
        tmp_path / "d", dataset_features(varied_episode(0)), encoding=Encoding(codec=codec)
    )
    for seed in range(2):
        writer.add(varied_episode(seed))
    writer.finish()
    table = datasets.load_dataset(str(tmp_path / "d"), split="train", cache_dir=str(tmp_path / "cache"))
    episodes = list(read_episodes(tmp_path / "d"))
    assert len(table) == sum(map(len, episodes))
    kinds = table.features
    assert (kinds["action"].feature.dtype, kinds["action"].length) == ("float32", 18)
    assert (kinds["timestamp"].dtype, kinds["episode_index"].dtype) == ("float32", "int64")
    assert kinds["next.success"].dtype == "bool"
    np.testing.assert_array_equal(table[0]["observation.state"], episodes[0].state[0])
    if codec == "images":
        assert isinstance(kinds["observation.images.ego"], datasets.Image)
        np.testing.assert_array_equal(np.asarray(table[0]["observation.images.ego"]), episodes[0].images["ego"][0])
