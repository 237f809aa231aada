"""Relative actions are displacements in physical units, whatever the normalisation."""

from __future__ import annotations

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.processor import NormalizerProcessorStep, TransitionKey, create_transition
from lerobot.utils.constants import ACTION, OBS_STATE
from lerobot_policy_tracker.action_frame import MIN_SPREAD, N_SPREAD_BATCHES, ActionFrame, affine_of, looks_absolute
from tracker_helpers import HAND_FEATURES, PUSH_FEATURES, make_batch, make_policy, make_step, stats_of

MODES = [NormalizationMode.MEAN_STD, NormalizationMode.MIN_MAX, NormalizationMode.QUANTILES, NormalizationMode.IDENTITY]


@pytest.mark.parametrize("mode", MODES)
def test_displacements_are_physical(mode: NormalizationMode) -> None:
    generator = torch.Generator().manual_seed(0)
    state = 3 + 0.5 * torch.randn(200, 5, generator=generator)
    moved = 0.04 * torch.randn(200, 3, generator=generator)
    action = torch.cat([state[:, :3] + moved, torch.randn(200, 4, generator=generator)], 1)
    frame = ActionFrame(3)
    stats = {OBS_STATE: stats_of(state), ACTION: stats_of(action)}
    frame.set_stats("state", affine_of(stats[OBS_STATE], mode))
    frame.set_stats("action", affine_of(stats[ACTION], mode))
    features = {
        OBS_STATE: PolicyFeature(FeatureType.STATE, (5,)),
        ACTION: PolicyFeature(FeatureType.ACTION, (7,)),
    }
    step = NormalizerProcessorStep(features, {FeatureType.STATE: mode, FeatureType.ACTION: mode}, stats)
    normalised = step(create_transition(observation={OBS_STATE: state}, action=action))
    actions = normalised[TransitionKey.ACTION][:, None]
    chunk = frame.to_model(actions, normalised[TransitionKey.OBSERVATION][OBS_STATE])
    torch.testing.assert_close(chunk[:, 0, :3], moved, rtol=0, atol=1e-5)  # the spread is still 1
    torch.testing.assert_close(chunk[..., 3:], actions[..., 3:])


def test_the_map_is_invertible_and_its_spread_is_one() -> None:
    frame = ActionFrame(2)
    frame.set_stats("action", (torch.tensor([0.5, 2.0]), torch.tensor([1.0, -1.0])))
    frame.set_stats("state", (torch.tensor([0.4, 1.0]), torch.tensor([0.9, -1.2])))
    actions, state = torch.randn(64, 8, 4), torch.randn(64, 6)
    frame.observe(actions, state, torch.ones(64, 8, dtype=torch.bool))
    chunk = frame.to_model(actions, state)
    torch.testing.assert_close(chunk[..., :2].square().mean((0, 1)), torch.ones(2), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(frame.to_actions(chunk, state), actions, rtol=1e-4, atol=1e-5)


def test_the_spread_ignores_padding_and_freezes() -> None:
    frame, keep = ActionFrame(1), torch.tensor([[True, False]])
    frame.observe(torch.tensor([[[2.0], [1e6]]]), torch.zeros(1, 1), keep)
    assert frame.mean_square.item() == 4.0
    for _ in range(N_SPREAD_BATCHES):
        frame.observe(torch.tensor([[[2.0], [1e6]]]), torch.zeros(1, 1), keep)
    frozen = frame.mean_square.clone()
    frame.observe(torch.full((1, 2, 1), 9.0), torch.zeros(1, 1), keep)
    assert frame.mean_square == frozen


def test_no_relative_dimension_is_the_identity() -> None:
    frame, actions = ActionFrame(0), torch.randn(2, 3, 4)
    assert torch.equal(frame.to_model(actions, torch.randn(2, 5)), actions)
    assert torch.equal(frame.to_actions(actions, torch.randn(2, 0)), actions)


def test_a_constant_feature_gives_finite_actions() -> None:
    frame = ActionFrame(1)
    frame.set_stats("action", (torch.zeros(1), torch.ones(1)))
    assert frame.to_actions(torch.randn(1, 2, 1), torch.randn(1, 1)).isfinite().all()


@pytest.mark.parametrize("action", ["target", "increment"])
def test_statistics_tell_targets_from_increments(action: str) -> None:
    state = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)).cumsum(0)
    actions = state.roll(-1, 0) if action == "target" else state.diff(dim=0)
    assert looks_absolute(stats_of(actions), stats_of(state), 3) == (action == "target")


def test_auto_chooses_and_the_choice_is_stored() -> None:
    state = torch.randn(500, 18, generator=torch.Generator().manual_seed(0)).cumsum(0)
    target = {"observation.state": stats_of(state), "action": stats_of(state.roll(-1, 0))}
    increment = {"observation.state": stats_of(state), "action": stats_of(state.diff(dim=0))}
    assert make_policy(stats=target).config.action_frame == "relative"
    assert make_policy(stats=increment).config.action_frame == "absolute"
    assert make_policy(stats=None).config.action_frame == "absolute"
    assert make_policy(PUSH_FEATURES, stats=target).config.action_frame == "absolute"  # fewer than three dimensions


def test_relative_without_a_state_is_refused() -> None:
    features = {key: value for key, value in HAND_FEATURES.items() if key != "observation.state"}
    with pytest.raises(ValueError, match="action_frame is 'relative' for 3 dimensions"):
        make_policy(features, action_frame="relative")


def test_a_relative_chunk_moves_with_the_hand() -> None:
    policy = make_policy(action_frame="relative")
    step = make_step(policy)
    moved = step | {"observation.state": step["observation.state"].clone()}
    moved["observation.state"][:, :3] += 0.7
    chunks = []
    for observation in (step, moved):
        policy.reset()
        chunks.append(policy.predict_action_chunk(observation, noise=torch.zeros(3, 8, 18)))
    torch.testing.assert_close((chunks[1] - chunks[0])[..., :3], torch.full((3, 8, 3), 0.7))  # an untrained head says 0
    torch.testing.assert_close(chunks[1][..., 3:], chunks[0][..., 3:])


def test_training_measures_the_spread_and_evaluation_does_not() -> None:
    policy = make_policy(action_frame="relative")
    batch = make_batch(policy)
    policy.eval()(batch)
    assert policy.frame.n_batches == 0
    policy.train()(batch)
    assert policy.frame.n_batches == 1


def test_a_motionless_first_batch_does_not_spoil_training() -> None:
    """With actions equal to the state all displacements are zero, and the initial spread of 1 must not survive."""
    policy = make_policy(action_frame="relative")
    batch = make_batch(policy)
    motionless = batch | {"action": batch["action"].clone()}
    motionless["action"][..., :3] = batch["observation.state"][:, -1:, :3]
    loss, _ = policy.train()(motionless)
    loss.backward()
    assert loss.isfinite()
    assert all(p.grad.isfinite().all() for p in policy.model.parameters() if p.grad is not None)
    torch.testing.assert_close(policy.frame.spread, torch.full((3,), MIN_SPREAD))
    moving, _ = policy.train()(batch)
    assert moving.isfinite()
    assert (policy.frame.spread > 0.1).all()


def test_a_tiny_first_displacement_is_measured_exactly() -> None:
    """Added to and subtracted from 1 in single precision, the square of 0.2 mm would lose all digits but one."""
    frame = ActionFrame(1)
    frame.observe(torch.full((1, 1, 1), 2e-4), torch.zeros(1, 1), torch.ones(1, 1, dtype=torch.bool))
    assert frame.spread.item() == pytest.approx(2e-4, rel=1e-6)


@pytest.mark.parametrize(("broken", "sentence"), [("action", "action of the batch"), ("observation.state", "state of")])
def test_a_loss_that_is_not_finite_stops_training(broken: str, sentence: str) -> None:
    policy = make_policy()
    batch = make_batch(policy) | {"index": torch.tensor([7, 8, 9])}
    batch[broken][1] = torch.nan
    with pytest.raises(FloatingPointError, match=rf"action loss is not finite: .*{sentence}.*frames 7, 8, 9"):
        policy.train()(batch)


def test_weights_that_are_not_finite_are_told_from_data_that_is_not() -> None:
    policy = make_policy()
    policy.model.camera.data.fill_(torch.nan)
    with pytest.raises(FloatingPointError, match="every input of the batch is finite"):
        policy.train()(make_batch(policy))
