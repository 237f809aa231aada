from __future__ import annotations

import json

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import HAND_NAMES
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.codecs import CODECS, Encoding
from dynahoi_lerobot.dataset.dataset_stats import SHOWN, histograms
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.subset import copy_subset
from dynahoi_lerobot.verify.runner import verify
from tests.dataset.episodes import write


@pytest.mark.parametrize("codec", CODECS.names())
def test_kept_episodes_are_copied_to_the_last_pixel(tmp_path, codec):
    root = write(tmp_path / "d", range(6), 64, encoding=Encoding(codec), views=("side",))
    copy_subset(root, tmp_path / "kept", [4, 1, 2])
    originals = list(read_episodes(root, [1, 2, 4]))
    copies = list(read_episodes(tmp_path / "kept"))
    for one, other in zip(originals, copies, strict=True):
        assert one.meta == other.meta
        assert other.images.keys() == {"ego", "side"}
        for view, images in one.images.items():
            np.testing.assert_array_equal(images, other.images[view])
        np.testing.assert_array_equal(one.action, other.action)
    assert verify(tmp_path / "kept", decoded=None) == []
    assert Manifest.read(tmp_path / "kept").provenance["kept"] == [1, 2, 4]


def test_impossible_subsets_are_refused(dataset, tmp_path):
    with pytest.raises(ValueError, match="at least one"):
        copy_subset(dataset, tmp_path / "x", [])
    with pytest.raises(ValueError, match="episode 7 does not exist"):
        copy_subset(dataset, tmp_path / "x", [0, 7])
    with pytest.raises(FileExistsError, match="choose a new folder"):
        copy_subset(dataset, tmp_path, [0])
    assert not any(tmp_path.iterdir())


def test_histograms_count_every_frame(dataset):
    shown = json.loads((dataset / "meta/histograms.json").read_text())
    frames = sum(row["length"] for row in Store(dataset).rows)
    for key in ("action", "observation.state"):
        assert tuple(shown[key]) == HAND_NAMES
        assert {sum(column["counts"]) for column in shown[key].values()} == {frames}


def test_histograms_are_those_of_numpy():
    values = np.random.default_rng(0).normal(size=(1000, 2)).astype(np.float32)
    values[:, 1] = 3.0
    stats = {key: {"min": values.min(axis=0), "max": values.max(axis=0)} for key in SHOWN}
    features = {key: {"names": ["a", "still"]} for key in SHOWN}
    shown = histograms(lambda key: np.split(values, 4), features, stats)["action"]
    np.testing.assert_array_equal(shown["a"]["counts"], np.histogram(values[:, 0], 50)[0])
    assert shown["still"]["counts"] == [1000] + [0] * 49
