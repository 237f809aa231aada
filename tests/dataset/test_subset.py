from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from dynahoi_lerobot.dataset import read_episodes, write_episodes
from dynahoi_lerobot.dataset.codecs.base import CODECS, Encoding
from dynahoi_lerobot.dataset.histograms import SHOWN, histograms
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.subset import copy_subset
from dynahoi_lerobot.foundation.conventions import HAND_NAMES
from dynahoi_lerobot.verify.outliers import find_outliers, reject_outliers
from dynahoi_lerobot.verify.verify import verify
from tests.dataset.episodes import varied_episode, write


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
    with pytest.raises(ValueError, match="no episode is kept"):
        copy_subset(dataset, tmp_path / "x", [])
    with pytest.raises(ValueError, match="episode 7 does not exist"):
        copy_subset(dataset, tmp_path / "x", [0, 7])
    with pytest.raises(FileExistsError, match="choose a new folder"):
        copy_subset(dataset, tmp_path, [0])
    assert not any(tmp_path.iterdir())


@pytest.fixture
def with_outlier(tmp_path):
    """Twelve episodes, of which one reaches a finger further than any other, for a single frame."""
    episodes = [varied_episode(seed, 16) for seed in range(12)]
    action = episodes[7].action.copy()
    action[10, 5] = 2.2
    episodes[7] = dataclasses.replace(episodes[7], action=action)
    write_episodes(tmp_path / "d", episodes)
    return tmp_path / "d"


def test_outliers_are_named(with_outlier):
    (outlier,) = find_outliers(with_outlier, margin=0.5)
    assert (outlier.episode, outlier.column, outlier.frames) == (7, "action.thumb_tip", 1)
    assert str(outlier) == "episode 7: action.thumb_tip is 2.200 in 1 frames; -0.500 to 1.500 is usual"
    assert find_outliers(with_outlier, margin=2.0) == []
    with pytest.raises(ValueError, match="margin is -1"):
        find_outliers(with_outlier, margin=-1)


def test_outliers_are_rejected(with_outlier, tmp_path):
    reject_outliers(with_outlier, tmp_path / "clean", margin=0.5)
    assert [row["seed"] for row in Store(tmp_path / "clean").rows] == [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11]
    assert verify(tmp_path / "clean") == []
    assert find_outliers(tmp_path / "clean", margin=0.5) == []


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
