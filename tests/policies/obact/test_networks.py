"""Attention in space and time; action heads: what they learn of a distribution, and how chunks
continue.
"""

from pathlib import Path

import pytest
import torch
from lerobot_policy_obact.attention import (
    AGE_STEP_S,
    N_AGES,
    AgeBias,
    PositionReadout,
    SpatialAttention,
    TemporalBlock,
)
from lerobot_policy_obact.configuration_obact import HEADS
from lerobot_policy_obact.gr00t_head import Gr00tHead
from lerobot_policy_obact.heads import ActionHead
from safetensors.torch import save_file

from tests.checkpoints import SMALL_GR00T


def bright(row: int, column: int, size: int = 8) -> torch.Tensor:
    cells = torch.zeros(1, size, size, 4)
    cells[0, row, column, 0] = 1.0
    return cells


@pytest.fixture
def looking() -> SpatialAttention:
    """Attention whose query is the first feature."""
    attention = SpatialAttention(4)
    torch.nn.init.zeros_(attention.query.weight)
    attention.query.weight.data[0, 0] = 40.0
    return attention


@torch.no_grad()
def test_the_ray_is_that_of_the_cell_attended_to_and_of_two_targets_one_is_looked_at(
    looking: SpatialAttention,
):
    for row, column, u, v in ((0, 0, -0.875, 0.875), (7, 7, 0.875, -0.875), (2, 5, 0.375, 0.375)):
        ray, there, heat = looking(bright(row, column))
        assert torch.allclose(ray, torch.tensor([[u, v]]), atol=1e-4)
        assert torch.allclose(there, torch.tensor([[1.0, 0, 0, 0]]), atol=1e-4)
        assert heat.exp().sum() == pytest.approx(1)
    ray, _, _ = looking(bright(1, 1) + 0.9 * bright(6, 6))
    assert torch.allclose(ray, torch.tensor([[-0.625, 0.625]]), atol=1e-3)


@pytest.mark.parametrize("fps", [20, 50, 100, 500])
def test_no_frame_sees_one_ahead_at_any_rate(fps: int):
    times = torch.arange(8, dtype=torch.double) / fps
    masked = AgeBias(2)((times[:, None] - times).float()).isinf()
    assert (masked == torch.ones(8, 8).triu(1).bool()).all()


def test_bias_is_interpolated_by_age_and_hides_the_future():
    bias = AgeBias(2)
    bias.table.data = torch.arange(2.0 * N_AGES).view(2, N_AGES)
    found = bias(torch.tensor([[-0.05, 0.0, 0.05, 0.125, 1000.0]]))
    assert found.shape == (2, 1, 5)
    assert torch.allclose(
        found[0, 0, 1:], torch.tensor([0.0, 1.0, 0.125 / AGE_STEP_S, N_AGES - 1]), atol=1e-4
    )
    assert found[0, 0, 0] == -torch.inf


def ages(n: int, step_s: float = 0.05) -> torch.Tensor:
    time_s = torch.arange(n) * step_s
    return time_s[:, None] - time_s


def test_readouts_return_convex_combinations_of_earlier_positions():
    torch.manual_seed(0)
    readout = PositionReadout(16, 5)
    positions = torch.arange(6.0)[None, :, None].expand(1, 6, 3)
    points, weights = readout(torch.randn(1, 6, 16), positions, ages(6), torch.tensor([[0, 3]]))
    torch.testing.assert_close(weights @ positions[:, None], points)
    assert points.shape == (1, 2, 5, 3)
    assert torch.allclose(points[0, 0], torch.zeros(5, 3), atol=1e-6)  # nothing but the first frame
    assert (points[0, 1] >= 0).all()
    assert (points[0, 1] <= 3).all()


@torch.no_grad()
def test_hidden_frames_change_nothing():
    torch.manual_seed(0)
    block = TemporalBlock(16, 4)
    readout = PositionReadout(16, 5)
    tokens = torch.randn(2, 9, 16)
    hidden = torch.arange(9).expand(2, 9) < 4
    positions = torch.randn(2, 9, 3)
    whole = block(tokens, ages(9), hidden)
    torch.testing.assert_close(whole[:, 4:], block(tokens[:, 4:], ages(5), None))
    points, weights = readout(tokens, positions, ages(9), torch.tensor([[4, 8]] * 2), hidden)
    alone, _ = readout(tokens[:, 4:], positions[:, 4:], ages(5), torch.tensor([[0, 4]] * 2))
    torch.testing.assert_close(points, alone)
    assert (weights[..., :4] == 0).all()


def trained(name: str) -> ActionHead:
    """A head that has learned ``two_answers`` in a context of zeros."""
    torch.manual_seed(0)
    head = HEADS[name](4, 1, [2], width=64)
    optimizer = torch.optim.Adam(head.parameters(), lr=3e-3)
    for _ in range(400):
        loss = head.loss(torch.zeros(256, 4), two_answers(256), torch.ones(256, 1)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return head.eval()


def two_answers(n: int) -> torch.Tensor:
    side = torch.randint(0, 2, (n, 1, 1)) * 2.0 - 1
    return torch.cat([side, torch.zeros_like(side)], dim=-1) + 0.05 * torch.randn(n, 1, 2)


@pytest.mark.parametrize("name", ["diffusion", "flow", "regression"])
def test_samples_cover_two_answers_and_nothing_between_but_regression_answers_with_the_middle(
    name: str,
):
    head = trained(name)
    with torch.no_grad():
        if name == "regression":
            first, second = head.sample(torch.zeros(2, 4), 0)
            assert torch.equal(first, second)
            assert first[0, 0].abs() < 1.1
            assert first[0, 1].abs() < 0.1
        else:
            samples = head.denoise(torch.zeros(1000, 4), torch.randn(1000, 1, 2), 8)[:, 0, 0]
            assert 0.4 < (samples > 0.5).float().mean() < 0.6
            assert 0.4 < (samples < -0.5).float().mean() < 0.6


PER_EMBODIMENT = ("state_encoder.", "action_encoder.", "action_decoder.")


@pytest.fixture
def released(tmp_path: Path) -> dict[str, torch.Tensor]:
    """The parameters of a small action head of two embodiments, saved in ``tmp_path`` as
    GR00T-N1.5's are.
    """
    torch.manual_seed(1)
    own = {
        key: value
        for key, value in Gr00tHead(4, 3, [2], **SMALL_GR00T).state_dict().items()
        if "condition" not in key
    }
    head = {
        k: torch.randn(2, *v.shape[1:]) if k.startswith(PER_EMBODIMENT) else torch.randn_like(v)
        for k, v in own.items()
    }
    rest = {"backbone.weight": torch.zeros(2)}
    save_file(
        {f"action_head.{key}": value for key, value in head.items()} | rest,
        tmp_path / "model.safetensors",
    )
    return head


def test_a_gr00t_head_starts_from_the_slot_of_its_embodiment(
    released: dict[str, torch.Tensor], tmp_path: Path
):
    head = Gr00tHead(4, 3, [2], checkpoint=str(tmp_path), embodiment=1, **SMALL_GR00T)
    head.load_pretrained()
    loaded = head.state_dict()
    for key, value in released.items():
        assert torch.equal(loaded[key], value[1:2] if key.startswith(PER_EMBODIMENT) else value), (
            key
        )
    assert head.sample(torch.zeros(5, 4), 0).shape == (5, 3, 2)


@pytest.mark.usefixtures("released")
@pytest.mark.parametrize("changes", [{"n_future_tokens": 7}, {"embodiment": -1}, {"embodiment": 2}])
def test_a_checkpoint_that_a_gr00t_head_does_not_fit_is_refused(tmp_path: Path, changes: dict):
    ((name, value),) = changes.items()
    head = Gr00tHead(
        4, 3, [2], **SMALL_GR00T | {"checkpoint": str(tmp_path), "embodiment": 1} | changes
    )
    with pytest.raises(ValueError, match=f"{name.removeprefix('n_')}.*{value}"):
        head.load_pretrained()
    save_file({"backbone.weight": torch.zeros(2)}, tmp_path / "model.safetensors")
    with pytest.raises(ValueError, match="no GR00T"):
        head.load_pretrained()


def test_a_gr00t_head_learns_which_way_to_go():
    torch.manual_seed(0)
    head = Gr00tHead(4, 1, [2], **SMALL_GR00T)
    optimizer = torch.optim.Adam(head.parameters(), lr=3e-3)
    sides = torch.tensor([-1.0, 1.0]).repeat(32)
    context = torch.zeros(64, 4)
    actions = torch.zeros(64, 1, 2)
    context[:, 0] = actions[:, 0, 0] = sides
    for _ in range(100):
        optimizer.zero_grad()
        head.loss(context, actions, torch.ones(64, 1)).mean().backward()
        optimizer.step()
    with torch.no_grad():
        assert (head.eval().sample(context, 0)[:, 0, 0].sign() == sides).float().mean() > 0.95
