"""Datasets of the simulator: physical ones, with further views, with failures; each verifies and
replays.
"""

import numpy as np
import pandas as pd
import pytest
from lerobot.datasets import LeRobotDataset

from dynahoi_lerobot.core.conventions import FINGERS
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.dataset import open_dataset, read_episodes
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.verify.command import verify
from tests.tools import generated


def test_a_physical_dataset_holds_forces(tmp_path):
    words = (
        "--episodes",
        "3",
        "--image-size",
        "32",
        "--motions",
        "constant,planar,struck",
        "--capture",
        "contact",
    )
    root = generated(tmp_path / "contact", *words)
    assert verify(root, replayed=1) == []
    dataset = LeRobotDataset("local/contact", root=root)
    assert dataset.meta.features[FEATURES["touch"].key]["names"] == list(FINGERS)
    touch = np.stack([dataset[i][FEATURES["touch"].key].numpy() for i in range(len(dataset))])
    assert touch.shape[1:] == (5,)
    assert (touch.max(axis=0) > 0.5).all(), "every finger has held something [N]"
    assert dataset.meta.stats[FEATURES["touch"].key]["max"].max() == pytest.approx(touch.max())
    rows = dataset.meta.episodes
    assert (set(rows["capture"]), set(rows["agent"]), set(rows["stage"])) == (
        {"contact"},
        {"match"},
        {"held"},
    )


VIEWS = ("side", "ego_depth", "ego_segmentation")


def test_further_views_are_stored_read_and_replayed(tmp_path):
    recording = Recording.of(motions=("constant", "struck"), image_size=48, views=VIEWS)
    generate(
        GenerationPlan(recording, 2, shard_episodes=1), tmp_path / "d", record=record
    )  # two shards, merged
    assert verify(tmp_path / "d", replayed=2) == []
    for episode in read_episodes(tmp_path / "d"):
        assert list(episode.images) == ["ego", *VIEWS]
        assert len({images.shape for images in episode.images.values()}) == 1
        assert np.abs(episode.images["side"].astype(int) - episode.images["ego"]).mean() > 5
    item = open_dataset(tmp_path / "d")[30]
    assert all(item[f"observation.images.{view}"].shape == (3, 48, 48) for view in ("ego", *VIEWS))


def test_failures_are_kept_in_their_place_and_marked(tmp_path):
    """A pursuer is too slow for some of them."""
    motions = ("constant", "lob", "depth", "planar")
    recording = Recording.of(
        expert="pursuit", motions=motions, image_size=16, keep_failures=True, perturbed_share=0.0
    )
    manifest = generate(
        GenerationPlan(recording, 8, shard_episodes=5), tmp_path / "d", record=record
    )
    assert manifest.seeds == list(range(8)), "nothing is drawn again"
    failed = int((~pd.read_parquet(tmp_path / "d/meta/episodes")["success"]).sum())
    assert 0 < failed < 8
    assert manifest.yields == {"tried": 8, "kept": 8, "failed": failed, "missed": 0, "rejected": 0}
    for episode in read_episodes(tmp_path / "d", images=False):
        assert episode.succeeded[-1] == episode.success
        assert episode.attempt_success.tolist() == [episode.success]
    assert verify(tmp_path / "d", replayed=3) == []


def test_all_attempts_at_a_failed_episode_are_told(tmp_path):
    recording = Recording.of(
        image_size=0, motions=("bounce", "lob"), perturbed_share=1.0, keep_failures=True
    )
    generate(GenerationPlan(recording, 8), tmp_path / "d", record=record)
    attempts = (
        pd.read_parquet(tmp_path / "d/meta/privileged_episodes")["attempt_success"]
        .map(list)
        .tolist()
    )
    assert max(map(len, attempts)) > 1, "the expert begins again"
    assert all(not any(tries[:-1]) for tries in attempts)
    assert verify(tmp_path / "d", replayed=2) == []
