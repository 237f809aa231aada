"""The GR00T-N1.5 head against LeRobot's modules with the same parameters, and its loader."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from lerobot.policies.groot.action_head.cross_attention_dit import DiT, SelfAttentionTransformer
from lerobot.policies.groot.groot_n1_7 import CategorySpecificMLP, MultiEmbodimentActionEncoder
from lerobot_policy_tracker import TrackerPolicy
from lerobot_policy_tracker.heads import ActionSpec, Condition
from lerobot_policy_tracker.heads.gr00t_n15 import Gr00tN15Head
from safetensors.torch import save_file
from tracker_helpers import PUSH_FEATURES, fit, make_batch, make_policy, mean_loss

SIZES = {
    "n_layers": 4,
    "n_heads": 2,
    "head_dim": 12,
    "hidden_dim": 20,
    "memory_dim": 16,
    "n_adapter_layers": 2,
    "n_adapter_heads": 2,
    "n_future_tokens": 3,
    "max_state_dim": 9,
    "max_action_dim": 7,
}
SPEC = ActionSpec(horizon=5, action_dim=6, state_dim=8, width=16, n_heads=2, dropout=0.0)
N_EMBODIMENTS, EMBODIMENT = 4, 3
RELEASED_PARAMETERS_M = {"model": 550.4, "vl_self_attention": 201.4, "action_encoder": 228.2, "state_encoder": 52.5}


class Reference(torch.nn.Module):
    """LeRobot's modules put together as the released head puts them together."""

    def __init__(self) -> None:
        super().__init__()
        common = {"dropout": 0.2, "final_dropout": True, "positional_embeddings": None}
        self.model = DiT(
            num_attention_heads=2,
            attention_head_dim=12,
            output_dim=20,
            num_layers=4,
            norm_type="ada_norm",
            interleave_self_attention=True,
            cross_attention_dim=16,
            **common,
        )
        self.state_encoder = CategorySpecificMLP(N_EMBODIMENTS, 9, 20, 24)
        self.action_encoder = MultiEmbodimentActionEncoder(7, 24, N_EMBODIMENTS)
        self.action_decoder = CategorySpecificMLP(N_EMBODIMENTS, 20, 20, 7)
        self.future_tokens = torch.nn.Embedding(3, 24)
        self.position_embedding = torch.nn.Embedding(1024, 24)
        self.vlln = torch.nn.LayerNorm(16)
        self.vl_self_attention = SelfAttentionTransformer(
            num_attention_heads=2, attention_head_dim=8, num_layers=2, **common
        )

    def sample(self, noise: torch.Tensor, tokens: torch.Tensor, state: torch.Tensor, n_steps: int) -> torch.Tensor:
        x, slot = noise, torch.full((len(noise),), EMBODIMENT)
        memory = self.vl_self_attention(self.vlln(tokens))
        state_token = self.state_encoder(torch.nn.functional.pad(state, (0, 1))[:, None], slot)
        for step in range(n_steps):
            bucket = torch.full((len(x),), int(step / n_steps * 1000))
            actions = self.action_encoder(x, bucket, slot) + self.position_embedding(torch.arange(x.shape[1]))
            queries = torch.cat([state_token, self.future_tokens.weight.expand(len(x), -1, -1), actions], 1)
            out = self.action_decoder(self.model(queries, memory, bucket), slot)
            x = x + out[:, -x.shape[1] :] / n_steps
        return x


@pytest.fixture
def reference() -> Reference:
    torch.manual_seed(0)
    module = Reference().eval()
    for parameter in module.parameters():
        parameter.data = 0.3 * torch.randn_like(parameter)
    return module


@pytest.fixture
def checkpoint(reference: Reference, tmp_path: Path) -> Path:
    """A folder in the layout of the release: two shards, an index, other parts beside the head."""
    state = {f"action_head.{key}": value.contiguous() for key, value in reference.state_dict().items()}
    names = sorted(state)
    shards = {"a.safetensors": names[::2], "b.safetensors": names[1::2]}
    for shard, keys in shards.items():
        save_file({key: state[key] for key in keys} | {f"backbone.{shard}": torch.zeros(1)}, tmp_path / shard)
    index = {"weight_map": {key: shard for shard, keys in shards.items() for key in keys}}
    (tmp_path / "model.safetensors.index.json").write_text(json.dumps(index))
    return tmp_path


def condition(seed: int = 1) -> Condition:
    generator = torch.Generator().manual_seed(seed)
    tokens, state = torch.randn(2, 6, 16, generator=generator), torch.randn(2, 8, generator=generator)
    return Condition(tokens, state, state)


@pytest.mark.parametrize("n_embodiments", [1, N_EMBODIMENTS])
def test_loaded_head_gives_the_outputs_of_the_reference(
    reference: Reference, checkpoint: Path, n_embodiments: int
) -> None:
    head = Gr00tN15Head(
        SPEC, checkpoint=str(checkpoint), embodiment=EMBODIMENT, n_embodiments=n_embodiments, **SIZES
    ).eval()
    head.load_pretrained()
    c, noise = condition(), torch.randn(2, 5, 7)
    expected = reference.sample(noise, c.tokens, c.state, n_steps=4)[..., :6]
    torch.testing.assert_close(head.sample(c, noise), expected, rtol=1e-5, atol=1e-5)


def test_names_and_shapes_are_those_of_the_reference(reference: Reference) -> None:
    own = Gr00tN15Head(SPEC, n_embodiments=N_EMBODIMENTS, **SIZES).state_dict()
    assert {k: v.shape for k, v in own.items()} == {k: v.shape for k, v in reference.state_dict().items()}


def test_default_sizes_are_the_released_ones() -> None:
    with torch.device("meta"):
        head = Gr00tN15Head(ActionSpec(16, 18, 49, 2048, 4, 0.0), n_embodiments=32)
    counted = {name: sum(p.numel() for p in getattr(head, name).parameters()) / 1e6 for name in RELEASED_PARAMETERS_M}
    assert counted == pytest.approx(RELEASED_PARAMETERS_M, abs=0.06)


def test_a_checkpoint_of_another_size_is_refused(checkpoint: Path) -> None:
    head = Gr00tN15Head(SPEC, checkpoint=str(checkpoint), embodiment=EMBODIMENT, **{**SIZES, "n_layers": 2})
    with pytest.raises(ValueError, match=r"model\.transformer_blocks\.2\..* but this gr00t_n15 head has None"):
        head.load_pretrained()


def test_a_checkpoint_without_head_is_refused(tmp_path: Path) -> None:
    save_file({"backbone.weight": torch.zeros(1)}, tmp_path / "model.safetensors")
    with pytest.raises(ValueError, match=r"it is no GR00T-N1\.5 checkpoint"):
        Gr00tN15Head(SPEC, checkpoint=str(tmp_path), **SIZES).load_pretrained()


def test_too_large_a_state_is_refused() -> None:
    with pytest.raises(ValueError, match="the state has 10 entries, but the gr00t_n15 head takes at most 9"):
        Gr00tN15Head(ActionSpec(5, 6, 10, 16, 2, 0.0), **SIZES)


def test_it_trains_and_acts_inside_the_policy() -> None:
    options = {**SIZES, "max_state_dim": 60, "max_action_dim": 20, "hidden_dim": 64, "n_layers": 2, "dropout": 0.0}
    policy = make_policy(head="gr00t_n15", head_options=options, ema_decay=0.0)
    batch = make_batch(policy, n=2)
    before = mean_loss(policy, batch)
    fit(policy, batch, n_steps=80, lr=3e-3)
    assert mean_loss(policy, batch) < 0.93 * before
    assert policy.predict_action_chunk(batch).shape == (2, 8, 18)
    assert policy.supports_rtc()


def test_training_starts_from_the_checkpoint_and_a_saved_policy_does_not_need_it(
    reference: Reference, checkpoint: Path, tmp_path: Path
) -> None:
    options = {**SIZES, "checkpoint": str(checkpoint), "embodiment": EMBODIMENT}
    policy = make_policy(PUSH_FEATURES, head="gr00t_n15", head_options=options).eval()
    weight = policy.model.head.model.proj_out_2.weight
    torch.testing.assert_close(weight, reference.model.proj_out_2.weight)
    policy.save_pretrained(tmp_path / "saved")
    for shard in checkpoint.glob("*.safetensors"):
        shard.unlink()
    opened = TrackerPolicy.from_pretrained(tmp_path / "saved")
    torch.testing.assert_close(opened.model.head.model.proj_out_2.weight, weight)
