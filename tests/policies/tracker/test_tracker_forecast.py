"""Training the forecast from a dataset: its labels, the frame before each frame, and that it learns from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot_policy_tracker.demonstrated import GRASP, Demonstrated
from lerobot_policy_tracker.heads.base import heads
from lerobot_policy_tracker.heads.intercept import KNOTS, InterceptHead
from lerobot_policy_tracker.observation import Observation
from tracker_helpers import FPS, HAND_FEATURES, fit, make_batch, make_policy, mean_loss

N_FRAMES, CAUGHT = 30, 20
IDENTITY = dict.fromkeys(("VISUAL", "STATE", "ENV", "ACTION"), "IDENTITY")
FORECASTING = {
    "backbone": "eye",
    "backbone_options": {"channels": 8, "fovea": 8, "embedding": 4},
    "head": "intercept",
    "head_options": {},
    "normalization_mapping": IDENTITY,
    "action_frame": "relative",
    "privileged_key": "target.pose",
    "privileged_weight": 0.0,
    "ema_decay": 0.0,
}


@pytest.fixture(scope="module")
def meta(tmp_path_factory: pytest.TempPathFactory) -> LeRobotDatasetMetadata:
    """Two episodes in which the target goes 1 cm a frame along x until it is caught, then stays."""
    root = tmp_path_factory.mktemp("data") / "catches"
    features = {key: HAND_FEATURES[key] for key in ("observation.state", "action")}
    features |= {"target.pose": {"dtype": "float32", "shape": (7,), "names": None}}
    features |= {"localized": {"dtype": "bool", "shape": (1,), "names": None}}
    dataset = LeRobotDataset.create("local/catches", fps=FPS, features=features, root=root, use_videos=False)
    for episode in range(2):
        for t in range(N_FRAMES):
            pose = np.array([0.01 * min(t, CAUGHT), episode, 0, 1, 0, 0, 0], np.float32)
            action = np.full(18, 0.02 * t + episode, np.float32)
            frame = {"observation.state": np.zeros(18, np.float32), "action": action, "target.pose": pose}
            dataset.add_frame({**frame, "localized": np.array([t >= CAUGHT]), "task": "catch"})
        dataset.save_episode()
    dataset.finalize()
    return LeRobotDatasetMetadata("local/catches", root=root)


def test_labels_follow_the_target_until_it_is_caught(meta: LeRobotDatasetMetadata):
    labels = Demonstrated(meta, "target.pose")(torch.tensor([10, N_FRAMES + 25]), [0])
    before, held = range(2)
    ahead = torch.tensor(KNOTS)
    torch.testing.assert_close(labels.known[before, 0], ahead <= CAUGHT - 10)
    free = labels.path[before, 0][labels.known[before, 0]]
    torch.testing.assert_close(free[:, 0], 0.01 * (10 + ahead[ahead <= 10]))
    assert labels.arrival[before, 0] == CAUGHT - 10
    assert labels.known[held, 0].all(), "a target that is held stays in the hand"
    torch.testing.assert_close(labels.path[held, 0], torch.tensor([0.2, 1.0, 0.0]).expand(len(KNOTS), 3))
    torch.testing.assert_close(labels.closed[held, 0], torch.full((15,), 0.02 * (N_FRAMES - 1) + 1))


def test_on_policy_the_teacher_says_when_it_would_arrive_and_failures_know_the_grasp(tmp_path: Path):
    """The hand never comes near, nobody closes it, and the teacher arrives earlier than the episode ends."""
    features = {key: HAND_FEATURES[key] for key in ("observation.state", "action")}
    features |= {"target.pose": {"dtype": "float32", "shape": (7,), "names": None}}
    features |= {"localized": {"dtype": "bool", "shape": (1,), "names": None}}
    root = tmp_path / "missed"
    dataset = LeRobotDataset.create("local/missed", fps=FPS, features=features, root=root, use_videos=False)
    for episode in range(2):
        for t in range(N_FRAMES):
            pose = np.array([0.01 * t, episode, 0, 1, 0, 0, 0], np.float32)
            goal = np.zeros(18, np.float32)
            goal[:2] = 0.01 * (t + 5 + episode + t % 3), episode
            told = {"observation.state": np.zeros(18, np.float32), "localized": np.array([False]), "action": goal}
            dataset.add_frame({**told, "target.pose": pose, "task": "catch"})
        dataset.save_episode()
    dataset.finalize()
    for file in root.glob("meta/episodes/*/*.parquet"):
        table = pq.read_table(file)
        grasps = pa.array([[0.1 * (1 + episode)] * 15 for episode in range(len(table))])
        paths = pa.array(
            [[x for t in range(2 * N_FRAMES) for x in (0.01 * t, float(episode), 0.0)] for episode in range(len(table))]
        )
        pq.write_table(table.append_column(GRASP, grasps).append_column("stats/target_path", paths), file)
    meta = LeRobotDatasetMetadata("local/missed", root=root)
    labels = Demonstrated(meta, "target.pose")(torch.tensor([10, N_FRAMES + 25]), [0, 1])
    assert labels.arrival.tolist() == [[6, 7], [7, 8]]
    ahead = torch.tensor(KNOTS)
    torch.testing.assert_close(labels.known[0, 0], ahead < N_FRAMES - 10)
    free = labels.path[0, 0][labels.known[0, 0]]
    torch.testing.assert_close(free[:, 0], 0.01 * (10 + ahead[ahead < N_FRAMES - 10]))
    torch.testing.assert_close(labels.closed[:, 0, 0], torch.tensor([0.1, 0.2]))


def test_a_policy_learns_them_from_a_batch(meta: LeRobotDatasetMetadata):
    policy = make_policy(meta=meta, **FORECASTING)
    batch = make_batch(policy) | {"index": torch.tensor([8, 12, N_FRAMES + 9])}
    before = mean_loss(policy, batch, n_draws=1)
    fit(policy, batch, n_steps=60, lr=1e-2)
    assert mean_loss(policy, batch, n_draws=1) < 0.5 * before


def test_a_dataset_without_the_column_is_refused(meta: LeRobotDatasetMetadata):
    with pytest.raises(ValueError, match="privileged_key must name a column, got ''"):
        make_policy(meta=meta, **FORECASTING | {"privileged_key": ""})


def test_any_head_that_forecasts_learns_from_them(meta: LeRobotDatasetMetadata, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(heads._classes, "foresee", type("Foresee", (InterceptHead,), {}))
    policy = make_policy(meta=meta, **FORECASTING | {"head": "foresee"})
    batch = make_batch(policy) | {"index": torch.tensor([8, 12, N_FRAMES + 9])}
    assert mean_loss(policy, batch, n_draws=1) > 0
    with pytest.raises(ValueError, match="head 'foresee' learns where targets go"):
        make_policy(meta=meta, **FORECASTING | {"head": "foresee", "privileged_key": ""})


@pytest.mark.parametrize("changes", [{}, {"n_decisions": 2, "decision_stride": 3}])
def test_every_frame_of_a_sample_is_beside_the_one_before_it(changes: dict):
    policy = make_policy(motion=True, **FORECASTING, **changes)
    batch = make_batch(policy)
    loaded, shown = policy.config.observation_delta_indices, policy.config.windows.observation_offsets
    for place, offset in enumerate(loaded):
        batch["observation.images.ego"][:, place] = offset / 100
    images = Observation.from_batch(batch, policy.config).images
    assert images.shape[:4] == (3, len(shown), 1, 6)
    for place, offset in enumerate(shown):
        torch.testing.assert_close(images[0, place, 0, :3].mean(), torch.tensor(offset / 100))
        torch.testing.assert_close(images[0, place, 0, 3:].mean(), torch.tensor((offset - 1) / 100))


def test_while_acting_it_is_the_frame_of_the_last_step():
    policy = make_policy(motion=True, **FORECASTING)
    first, second = (torch.full((1, 3, 64, 64), value) for value in (0.2, 0.7))
    step = {key: value[:1, -1] for key, value in make_batch(policy).items() if torch.is_tensor(value) and "obs" in key}
    step = {key: value for key, value in step.items() if not key.endswith("_is_pad")}
    for image, before in ((first, 0.2), (second, 0.2), (first, 0.7)):
        shown = policy.planner.observe(step | {"observation.images.ego": image}).images
        assert shown[0, 0, 0, 3:].mean() == pytest.approx(before)
    policy.reset()
    shown = policy.planner.observe(step | {"observation.images.ego": first}).images
    assert shown[0, 0, 0, 3:].mean() == pytest.approx(0.2), "a new episode begins with nothing before it"


def test_a_backbone_of_single_images_refuses_motion():
    with pytest.raises(ValueError, match="backbone 'conv' takes one image at a time"):
        make_policy(motion=True)
