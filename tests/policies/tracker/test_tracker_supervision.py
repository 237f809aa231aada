"""What is learned from: chunks that are executed, and the position that only the dataset knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.processor import NormalizerProcessorStep, TransitionKey, create_transition
from lerobot_policy_tracker.eye import StandardisedPatches, saturation
from lerobot_policy_tracker.observation import Observation
from lerobot_policy_tracker.privileged import FrameColumn
from tracker_helpers import FPS, fit, make_batch, make_policy, mean_loss, phase_of, randomise, stats_of

PHASE = "observation.phase"
STATS = {
    key: {"mean": np.zeros(18, np.float32), "std": np.full(18, 2.0, np.float32)}
    for key in ("observation.state", "action")
}
RELATIVE = {"stats": STATS, "action_frame": "relative"}


class Place:
    """A target that is everywhere at the same place [m]."""

    def __call__(self, index: torch.Tensor, offsets: list[int]) -> torch.Tensor:
        return torch.tensor([1.0, -2.0, 0.5]).expand(len(index), len(offsets), 3)


@pytest.fixture(scope="module")
def target_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "target"
    features = {
        "observation.state": {"dtype": "float32", "shape": (3,), "names": None},
        "target.pose": {"dtype": "float32", "shape": (7,), "names": None},
        "action": {"dtype": "float32", "shape": (3,), "names": None},
    }
    dataset = LeRobotDataset.create("local/target", fps=FPS, features=features, root=root, use_videos=False)
    for episode in range(2):
        for t in range(5):
            frame = {key: np.zeros(feature["shape"], np.float32) for key, feature in features.items()}
            frame["target.pose"] = 100 * episode + 10 * t + np.arange(7, dtype=np.float32)
            dataset.add_frame({**frame, "task": "catch"})
        dataset.save_episode()
    dataset.finalize()
    return root


def test_a_frame_column_is_looked_up_by_global_index(target_root: Path) -> None:
    column = FrameColumn(LeRobotDatasetMetadata("local/target", root=target_root), "target.pose", 3)
    found = column(torch.tensor([1, 7]), [-1, 0, 2])
    expected = [[[0, 1, 2], [10, 11, 12], [30, 31, 32]], [[110, 111, 112], [120, 121, 122], [140, 141, 142]]]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float32))


@pytest.mark.parametrize(("key", "n_dims"), [("target.velocity", 3), ("target.pose", 8)])
def test_a_column_that_is_not_there_is_refused(target_root: Path, key: str, n_dims: int) -> None:
    meta = LeRobotDatasetMetadata("local/target", root=target_root)
    with pytest.raises(ValueError, match=key):
        FrameColumn(meta, key, n_dims)


def test_privileged_supervision_needs_relative_actions(target_root: Path) -> None:
    meta = LeRobotDatasetMetadata("local/target", root=target_root)
    with pytest.raises(ValueError, match="privileged_key must be ''"):
        make_policy(privileged_key="target.pose", action_frame="absolute", meta=meta)


def test_the_probe_learns_where_the_target_is_relative_to_the_palm() -> None:
    policy = make_policy(**RELATIVE, privileged_key="target.pose", ema_decay=0.0)
    policy.objective.labels = Place()
    batch = make_batch(policy) | {"index": torch.arange(3)}
    policy.config.privileged_weight = 10.0
    before = mean_loss(policy, batch)
    fit(policy, batch, 150, 1e-2)
    assert mean_loss(policy, batch) < 0.5 * before
    observation = Observation.from_batch(batch, policy.config)
    seen = policy.model.probe(policy.model.encode(observation).tokens)
    wanted = torch.tensor([1.0, -2.0, 0.5]) / 2.0 - observation.position[..., :3]
    assert (seen - wanted).abs().mean() < 0.3 * wanted.abs().mean()


def test_padded_frames_do_not_teach_the_probe() -> None:
    policy = randomise(make_policy(**RELATIVE, privileged_key="target.pose"))
    policy.objective.labels = Place()
    batch = make_batch(policy) | {"index": torch.arange(3)}
    batch["action_is_pad"][:] = True  # what remains is the probe's loss
    batch["observation.state_is_pad"][:, 0] = True
    for key in policy.config.input_features:
        batch[f"{key}_is_pad"] = batch["observation.state_is_pad"]
    masked = mean_loss(policy, batch, 1)
    batch["observation.state"] = batch["observation.state"].clone()
    batch["observation.state"][:, 0] += 50.0
    assert mean_loss(policy, batch, 1) == pytest.approx(masked)
    batch["observation.state"][:, 1] += 50.0
    assert mean_loss(policy, batch, 1) > masked + 1


def test_acting_needs_no_privileged_column(tmp_path: Path) -> None:
    policy = make_policy(**RELATIVE, privileged_key="target.pose")
    assert policy.objective.labels is None
    policy.save_pretrained(tmp_path)
    again = type(policy).from_pretrained(tmp_path)
    batch = make_batch(policy)
    torch.testing.assert_close(again.predict_action_chunk(batch), policy.predict_action_chunk(batch))


@pytest.mark.parametrize("reduction", ["mean", "none"])
def test_chunks_planned_while_observing_are_not_learned_from(reduction: str) -> None:
    policy = randomise(make_policy(n_decisions=2)).eval()
    batch, now = make_batch(policy), policy.config.windows.frame_index[0][-1]
    later = policy.config.windows.frame_index[1][-1]
    batch[PHASE][..., 1] = -0.5
    batch[PHASE][:, later, 1] = 1.5
    wrong = batch | {"action": batch["action"].clone()}
    wrong["action"][:, 0] += 100.0  # only the first decision's chunk begins there

    def loss(b: dict) -> torch.Tensor:
        torch.manual_seed(0)
        return policy(b, reduction=reduction)[0].detach()

    torch.testing.assert_close(loss(wrong), loss(batch), rtol=0, atol=0)
    for b in (batch, wrong):
        b[PHASE][:, now, 1] = 1.5
    assert (loss(wrong) - loss(batch)).min() > 1


def normalised(phase: torch.Tensor, mode: NormalizationMode, stats: dict) -> torch.Tensor:
    """Normalise as LeRobot's preprocessor does."""
    features = {PHASE: PolicyFeature(FeatureType.STATE, (2,))}
    step = NormalizerProcessorStep(features, {FeatureType.STATE: mode}, {PHASE: stats})
    return step(create_transition(observation={PHASE: phase}))[TransitionKey.OBSERVATION][PHASE]


@pytest.mark.parametrize("mode", NormalizationMode)
@pytest.mark.parametrize(("n_observing", "n_acting"), [(20, 80), (1, 1999), (1999, 1), (0, 100), (100, 0)])
def test_executed_chunks_are_recognised_under_every_normalisation(
    mode: NormalizationMode, n_observing: int, n_acting: int
) -> None:
    """A decision before the rise of the phase is not learned from; in data without a rise every one is."""
    acting = (torch.arange(n_observing + n_acting) >= n_observing).float()
    data = phase_of(acting)
    mapping = {"STATE": mode, "ACTION": NormalizationMode.IDENTITY, "VISUAL": NormalizationMode.IDENTITY}
    policy = make_policy(n_decisions=2, normalization_mapping=mapping, stats={PHASE: stats_of(data)}).eval()
    batch, second = make_batch(policy), policy.config.windows.frame_index[1][-1]
    phase = data[0].expand_as(batch[PHASE]).clone()
    phase[:, second:] = data[-1]
    batch[PHASE] = normalised(phase, mode, stats_of(data))
    learned = []
    for action in (0, -1):  # the first decision alone predicts the first action, the second alone the last one
        wrong = batch | {"action": batch["action"].clone()}
        wrong["action"][:, action] += 100.0
        learned.append(mean_loss(policy, wrong, 1) > mean_loss(policy, batch, 1) + 1)
    assert learned == [len(acting.unique()) == 1, True]


def test_a_batch_that_only_observes_gives_every_weight_a_zero_gradient() -> None:
    policy = make_policy(ema_decay=0.0)
    batch = make_batch(policy)
    batch[PHASE][..., 1] = -0.5
    policy.train()(batch)[0].backward()
    assert all(p.grad is not None and not p.grad.any() for p in policy.model.head.parameters())


def test_the_weight_of_relative_dimensions_shifts_the_loss_without_scaling_it() -> None:
    policy = randomise(make_policy(**RELATIVE, ema_decay=0.0)).eval()
    batch = make_batch(policy)

    def loss(weight: float, changed: slice) -> float:
        policy.config.relative_weight = weight
        wrong = batch | {"action": batch["action"].clone()}
        wrong["action"][..., changed] += 100.0
        return mean_loss(policy, wrong, 1)

    palm, fingers = slice(0, 3), slice(3, None)
    assert loss(9.0, palm) > 3 * loss(1.0, palm)
    assert loss(9.0, fingers) < loss(1.0, fingers) / 2
    policy.model.head.loss = lambda actions, condition: torch.ones_like(actions)
    assert loss(9.0, palm) == pytest.approx(loss(1.0, palm))


@pytest.mark.slow
def test_a_chunk_predicting_flow_learns_one_chunk_and_returns_it() -> None:
    options = {"n_layers": 1, "predicts": "chunk"}
    policy = make_policy(head_options=options, ema_decay=0.0, action_frame="absolute")
    batch = make_batch(policy, 1)
    fit(policy, batch, 300, 1e-2)
    chunk = policy.predict_action_chunk(batch)
    assert (chunk - batch["action"][:, : policy.config.horizon]).abs().mean() < 0.2


def test_an_unknown_prediction_is_refused() -> None:
    with pytest.raises(ValueError, match="predicts is 'noise', but must be one of velocity, chunk"):
        make_policy(head_options={"predicts": "noise"})


def test_saturation_tells_colours_from_greys() -> None:
    grey, red = torch.full((1, 3, 2, 2), 0.4), torch.zeros(1, 3, 2, 2)
    red[:, 0] = 1.0
    assert saturation(grey).unique().tolist() == [0.0]
    assert saturation(red).unique().tolist() == [1.0]


def test_patches_are_read_as_if_their_pixels_were_standardised() -> None:
    torch.manual_seed(0)
    patches, images = StandardisedPatches(2, 3), torch.rand(4, 2, 8, 12)
    mean, std = torch.tensor([0.5, 0.2]).view(-1, 1, 1), torch.tensor([0.25, 0.5]).view(-1, 1, 1)
    expected = torch.nn.functional.conv2d((images - mean) / std, patches.weight, patches.bias, stride=4)
    torch.testing.assert_close(patches(images, mean, std), expected)
