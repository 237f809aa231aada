"""Actions as tokens: the bins, constrained writing, learning, padding, checkpoints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot_policy_actiontokens import ActionTokensConfig, ActionTokensPolicy
from lerobot_policy_actiontokens.bins import N_BINS, decode, encode, token_ids

from tests.zoo.stand_ins import save_smolvlm

SIZE, VOCABULARY = 3, 1000


@pytest.fixture(scope="module")
def vlm(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("models") / "smolvlm"
    save_smolvlm(folder)
    return str(folder)


def make_policy(vlm: str, **changes: object) -> ActionTokensPolicy:
    torch.manual_seed(0)
    config = ActionTokensConfig(
        vlm_name=vlm,
        device="cpu",
        load_weights=False,
        push_to_hub=False,
        input_features={"observation.images.ego": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (SIZE,))},
        **changes,
    )
    return ActionTokensPolicy(config)


def make_batch(policy: ActionTokensPolicy, n: int = 2, seed: int = 0) -> dict[str, object]:
    generator = torch.Generator().manual_seed(seed)
    actions = 2 * torch.rand(n, policy.config.chunk_size, SIZE, generator=generator) - 1
    images = torch.rand(n, 3, 32, 32, generator=generator)
    return {"observation.images.ego": images, "action": actions, "task": ["Catch the ball."] * n}


def test_bins_are_those_of_openvla() -> None:
    values = np.random.default_rng(0).uniform(-1.2, 1.2, 2000)
    edges = np.linspace(-1, 1, 256)
    expected = VOCABULARY - np.digitize(np.clip(values, -1, 1), edges)
    ids = encode(torch.tensor(values), VOCABULARY)
    assert (ids.numpy() == expected).mean() > 0.999  # single precision moves a value on an edge
    centres = (edges[:-1] + edges[1:]) / 2
    middles = centres[np.clip(VOCABULARY - ids.numpy() - 1, 0, 254)]
    np.testing.assert_allclose(decode(ids, VOCABULARY), middles, atol=1e-6)
    assert np.abs(decode(ids, VOCABULARY).numpy() - np.clip(values, -1, 1)).max() <= 1 / 255 + 1e-6
    assert set(ids.tolist()) <= set(token_ids(VOCABULARY))
    assert len(token_ids(VOCABULARY)) == N_BINS


def test_it_learns_a_chunk_and_writes_it(vlm: str) -> None:
    policy = make_policy(vlm, chunk_size=2, n_action_steps=2)
    batch = make_batch(policy, n=1)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-2)
    for _ in range(60):
        policy.train()(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
    chunk = policy.predict_action_chunk(batch)
    assert chunk.shape == (1, 2, SIZE)
    assert (chunk - batch["action"]).abs().max() <= 1 / 255 + 1e-6


def test_an_untrained_model_writes_actions_and_nothing_else(vlm: str) -> None:
    policy = make_policy(vlm)
    chunk = policy.predict_action_chunk(make_batch(policy, n=4))
    assert chunk.shape == (4, 1, SIZE)
    assert chunk.abs().max() <= 1


def test_a_longer_instruction_beside_it_changes_nothing(vlm: str) -> None:
    policy = make_policy(vlm).eval()
    batch = make_batch(policy)
    alone = policy(batch, reduction="none")[0]
    mixed = batch | {"task": ["Catch the ball.", "Catch the moving ball that is being the ball."]}
    torch.testing.assert_close(policy(mixed, reduction="none")[0][0], alone[0], rtol=1e-4, atol=1e-5)
    assert (policy(mixed, reduction="none")[0][1] - alone[1]).abs() > 1e-6


def test_padded_actions_are_not_learned_from(vlm: str) -> None:
    policy = make_policy(vlm, chunk_size=2).eval()
    batch = make_batch(policy) | {"action_is_pad": torch.tensor([[False, True], [False, False]])}
    other = batch | {"action": batch["action"].clone()}
    other["action"][:, 1] = -other["action"][:, 1]
    before, after = (policy(b, reduction="none")[0] for b in (batch, other))
    torch.testing.assert_close(before[0], after[0])
    assert (before[1] - after[1]).abs() > 1e-6


def test_a_checkpoint_brings_its_own_weights(vlm: str, tmp_path: Path) -> None:
    policy = make_policy(vlm)
    policy.save_pretrained(tmp_path)
    again = ActionTokensPolicy.from_pretrained(tmp_path)
    batch = make_batch(policy)
    torch.testing.assert_close(again.predict_action_chunk(batch), policy.predict_action_chunk(batch))
    torch.testing.assert_close(again.eval()(batch)[0], policy.eval()(batch)[0])


def test_the_vision_tower_stays_as_it_is(vlm: str) -> None:
    frozen, free = make_policy(vlm), make_policy(vlm, freeze_vision=False)
    assert len(frozen.get_optim_params()) < len(free.get_optim_params())
    assert all("vision" in name for name, p in frozen.named_parameters() if not p.requires_grad)


def test_one_call_per_chunk(vlm: str) -> None:
    policy = make_policy(vlm, chunk_size=2, n_action_steps=2)
    batch = make_batch(policy)
    chunk = policy.predict_action_chunk(batch)
    for t in range(2):
        torch.testing.assert_close(policy.select_action(batch), chunk[:, t])
    assert not policy._queue
    policy.select_action(batch)
    policy.reset()
    assert not policy._queue


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"n_action_steps": 2}, "n_action_steps is 2, but must be 1 to 1"), ({"dtype": "int8"}, "int8")],
)
def test_bad_values_are_named(vlm: str, changes: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make_policy(vlm, **changes)
