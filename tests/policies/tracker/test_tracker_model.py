"""What the network may and may not know, and that it learns."""

from __future__ import annotations

import itertools

import pytest
import torch
from lerobot_policy_tracker.attention import SpatioTemporalAttention, TemporalAttention
from lerobot_policy_tracker.backbones import backbones
from lerobot_policy_tracker.decisions import Decisions, window_decisions
from lerobot_policy_tracker.heads import heads
from lerobot_policy_tracker.observation import Observation
from tracker_helpers import HAND_FEATURES, PUSH_FEATURES, fit, make_batch, make_policy, mean_loss, randomise

N_OBS = 2


def chunk_of(policy, batch: dict) -> torch.Tensor:
    return policy.predict_action_chunk(batch)


def scrambled(batch: dict, frames: slice, seed: int = 9) -> dict:
    """Return the batch with other images and vectors at ``frames``."""
    torch.manual_seed(seed)
    changed = {key: value.clone() if torch.is_tensor(value) else value for key, value in batch.items()}
    for key, value in changed.items():
        if key.startswith("observation.") and not key.endswith("_is_pad"):
            value[:, frames] = torch.rand_like(value[:, frames])
    return changed


def test_untrained_history_policy_equals_the_single_frame_control() -> None:
    history, control = randomise(make_policy(n_obs_frames=N_OBS)), make_policy(n_obs_frames=0)
    untrained = make_policy(n_obs_frames=N_OBS).state_dict()
    gates = {key: value for key, value in untrained.items() if key.endswith("gate")}
    history.load_state_dict({**history.state_dict(), **gates})  # the rest is random: an untrained head only says 0
    control.load_state_dict(history.state_dict())
    batch = make_batch(history)
    now = {key: value[:, -1:] if key.startswith("observation.") else value for key, value in batch.items()}
    torch.testing.assert_close(chunk_of(history, batch), chunk_of(control, now), rtol=1e-3, atol=1e-4)


def test_trained_history_policy_uses_its_history_and_the_control_cannot() -> None:
    history, control = randomise(make_policy(n_obs_frames=N_OBS)), randomise(make_policy(n_obs_frames=0))
    batch = make_batch(history)
    other = scrambled(batch, slice(0, N_OBS))
    assert (chunk_of(history, batch) - chunk_of(history, other)).abs().max() > 1e-3
    for frames in (batch, other):
        frames |= {key: value[:, -1:] for key, value in frames.items() if key.startswith("observation.")}
    torch.testing.assert_close(chunk_of(control, batch), chunk_of(control, other), rtol=0, atol=0)


def test_padded_frames_change_nothing() -> None:
    policy = randomise(make_policy(n_obs_frames=N_OBS))
    batch = make_batch(policy)
    for key in list(batch):
        if key.startswith("observation.") and key.endswith("_is_pad"):
            batch[key][:, 0] = True
    other = scrambled(batch, slice(0, 1))
    torch.testing.assert_close(chunk_of(policy, batch), chunk_of(policy, other), rtol=0, atol=0)
    seen = scrambled(batch, slice(1, 2))
    assert (chunk_of(policy, batch) - chunk_of(policy, seen)).abs().max() > 1e-3


def test_padded_actions_do_not_enter_the_loss() -> None:
    policy = make_policy(action_frame="absolute").eval()  # an untrained head predicts 0 for every entry on its own
    batch = make_batch(policy)
    batch["action_is_pad"][:, 5:] = True
    padded, kept = (dict(batch, action=batch["action"].clone()) for _ in range(2))
    padded["action"][:, 5:] += 3
    kept["action"][:, :5] += 3
    losses = []
    for variant in (batch, padded, kept):
        torch.manual_seed(0)
        losses.append(policy(variant)[0].item())
    assert losses[0] == losses[1]
    assert losses[2] > losses[0] + 1
    batch["action_is_pad"][:] = True
    assert policy(batch)[0] == 0


@pytest.mark.parametrize("decision", [0, 1])
def test_decisions_are_causal(decision: int) -> None:
    policy = randomise(make_policy(n_obs_frames=N_OBS, obs_stride=1, n_decisions=3, decision_stride=2)).eval()
    batch = make_batch(policy)
    windows = policy.config.windows
    now = windows.frame_index[decision][-1]

    def condition(b: dict) -> torch.Tensor:
        observation = Observation.from_batch(b, policy.config)
        frames = policy.model.encode(observation)
        tokens = policy.model.conditions(frames, window_decisions(frames, windows.frame_index, policy.config)).tokens
        return tokens.unflatten(0, (-1, 3))[:, decision]

    later = scrambled(batch, slice(now + 1, None))
    torch.testing.assert_close(condition(batch), condition(later), rtol=0, atol=0)
    earlier = scrambled(batch, slice(now, now + 1))
    assert (condition(batch) - condition(earlier)).abs().max() > 1e-3


def test_several_decisions_equal_the_same_decisions_one_by_one() -> None:
    many = randomise(make_policy(n_obs_frames=N_OBS, n_decisions=3, decision_stride=4))
    one = make_policy(n_obs_frames=N_OBS)
    one.load_state_dict(many.state_dict())
    batch, windows = make_batch(many) | {"task": ["catch the ball", "drop it", ""]}, many.config.windows
    observation = Observation.from_batch(batch, many.config)
    frames = many.model.encode(observation)
    together = many.model.conditions(frames, window_decisions(frames, windows.frame_index, many.config))
    for k, row in enumerate(windows.frame_index):
        seen = one.model.encode(observation.frames(row))
        alone = one.model.conditions(seen, window_decisions(seen, [[0, 1, 2]], one.config))
        torch.testing.assert_close(together.tokens.unflatten(0, (-1, 3))[:, k], alone.tokens, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(together.state.unflatten(0, (-1, 3))[:, k], alone.state)


def test_wanted_decisions_do_not_depend_on_the_others() -> None:
    policy = randomise(make_policy(n_obs_frames=N_OBS, n_decisions=3, decision_stride=4))
    frames = policy.model.encode(Observation.from_batch(make_batch(policy), policy.config))
    windows = policy.config.windows
    wanted = torch.tensor([[True, False, True], [False, False, False], [False, True, False]])
    all_three, some = (
        policy.model.conditions(frames, window_decisions(frames, windows.frame_index, policy.config, which))
        for which in (None, wanted)
    )
    torch.testing.assert_close(some.tokens, all_three.tokens[wanted.flatten()])
    torch.testing.assert_close(some.state, all_three.state[wanted.flatten()])


def test_age_is_in_seconds_so_frame_rate_and_stride_are_exchangeable() -> None:
    slow = randomise(make_policy(n_obs_frames=N_OBS, obs_stride=1, fps=10.0))
    fast = randomise(make_policy(n_obs_frames=N_OBS, obs_stride=2, fps=20.0))
    other = randomise(make_policy(n_obs_frames=N_OBS, obs_stride=2, fps=10.0))
    batch = make_batch(slow)
    torch.testing.assert_close(chunk_of(slow, batch), chunk_of(fast, batch))
    assert (chunk_of(slow, batch) - chunk_of(other, batch)).abs().max() > 1e-4


def test_each_token_reads_its_own_kept_past() -> None:
    torch.manual_seed(0)
    attention, index = TemporalAttention(8, 2), [[0, 1, 2], [1, 2, 4]]
    frames, age_k, age_v = torch.randn(2, 5, 3, 8), torch.randn(3, 8), torch.randn(3, 8)
    keep = torch.tensor([[True] * 5, [True, False, True, True, True]])
    decisions = Decisions.among(keep, index, torch.tensor([0.2, 0.1, 0.0]))
    x = torch.randn(4, 3, 8)
    read = attention(x, frames, decisions, (age_k, age_v)).unflatten(0, (2, 2))
    for b, k, n in itertools.product(range(2), range(2), range(3)):
        seen = [w for w, frame in enumerate(index[k]) if keep[b, frame]]
        memory = frames[b, [index[k][w] for w in seen], n]  # (seen, 8)
        keys = (attention.k_proj(memory) + age_k[seen]).unflatten(-1, (2, 4))
        values = (attention.v_proj(memory) + age_v[seen]).unflatten(-1, (2, 4))
        query = attention.q_proj(x[2 * b + k, n]).unflatten(-1, (2, 4))
        weights = (torch.einsum("hd,whd->hw", query, keys) / 2).softmax(-1)
        expected = attention.o_proj(torch.einsum("hw,whd->hd", weights, values).flatten())
        torch.testing.assert_close(read[b, k, n], expected)


def test_the_gate_of_an_untrained_block_is_open_to_gradients() -> None:
    torch.manual_seed(0)
    module = SpatioTemporalAttention(8, 1, 2)
    keep, age_s = torch.ones(2, 3, dtype=torch.bool), torch.tensor([0.2, 0.1, 0.0])
    out = module(torch.randn(2, 3, 4, 8), Decisions.among(keep, [[0, 1, 2]], age_s))
    out.square().sum().backward()
    assert module.blocks[0].gate.grad.abs().min() > 0


@pytest.mark.parametrize("name", ["diffusion", "flow"])
@pytest.mark.parametrize("features", [HAND_FEATURES, PUSH_FEATURES], ids=["hand", "push"])
def test_every_head_of_chunks_learns_one_batch(name: str, features: dict) -> None:
    policy = make_policy(features, head=name, ema_decay=0.0, head_options={"n_layers": 1, "n_draws": 8})
    batch = make_batch(policy, n=2)
    before = mean_loss(policy, batch)
    fit(policy, batch, n_steps=50, lr=1e-2)
    assert mean_loss(policy, batch) < 0.7 * before


@pytest.mark.parametrize("reduction", ["mean", "none"])
def test_loss_reductions_agree_without_padding(reduction: str) -> None:
    policy = make_policy().eval()
    batch = make_batch(policy)
    torch.manual_seed(0)
    scalar = policy(batch)[0]
    torch.manual_seed(0)
    loss = policy(batch, reduction=reduction)[0]
    assert loss.shape == (() if reduction == "mean" else (3,))
    torch.testing.assert_close(loss.mean(), scalar)


def test_unknown_names_and_options_list_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"unknown backbone 'vgg': choose one of conv, .*resnet18"):
        make_policy(backbone="vgg")
    with pytest.raises(ValueError, match="head 'flow' has no option 'layers': it takes n_layers, n_steps"):
        make_policy(head_options={"layers": 3})
    assert {"conv", "resnet18", "smolvlm2", "transformers_vision"} <= set(backbones.names())
    assert {"diffusion", "flow", "gr00t_n15", "intercept"} == set(heads.names())


def test_instructions_matter() -> None:
    policy = randomise(make_policy())
    batch = make_batch(policy)
    chunk = chunk_of(policy, batch)
    other = chunk_of(policy, batch | {"task": ["drop it", "catch the ball", ""]})
    changed = (chunk - other).abs().amax(dim=(1, 2)) > 1e-4
    assert changed.tolist() == [True, False, True]
