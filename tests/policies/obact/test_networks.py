"""Attention in space and time; action heads: what they learn of a distribution, and how chunks
continue.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from lerobot_policy_obact.attention import (
    AGE_STEP_S,
    N_AGES,
    AgeBias,
    PositionReadout,
    SpatialAttention,
    out_of_sight,
)
from lerobot_policy_obact.forecaster import FORECAST_FRAMES, Forecast
from lerobot_policy_obact.gr00t_head import Gr00tHead
from lerobot_policy_obact.heads import ActionHead
from safetensors.torch import save_file

from tests.checkpoints import SMALL_GR00T, fit


def bright(row: int, column: int, size: int = 8) -> torch.Tensor:
    cells = torch.zeros(1, size, size, 4)
    cells[0, row, column, 0] = 1.0
    return cells


@torch.no_grad()
def test_the_ray_is_that_of_the_cell_attended_to_and_of_two_targets_one_is_looked_at():
    """The query is the first feature."""
    looking = SpatialAttention(4)
    torch.nn.init.zeros_(looking.query.weight)
    looking.query.weight[0, 0] = 40.0
    ray, there, heat = looking(bright(7, 7))
    assert ray[0].tolist() == pytest.approx([0.875, -0.875], abs=1e-4)
    assert there[0].tolist() == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-4)
    assert heat.exp().sum() == pytest.approx(1)
    ray, _, _ = looking(bright(1, 1) + 0.9 * bright(6, 6))
    assert ray[0].tolist() == pytest.approx([-0.625, 0.625], abs=1e-3)


@pytest.mark.parametrize("fps", [20, 50, 100, 500])
def test_no_frame_sees_one_ahead_at_any_rate(fps: int):
    times = torch.arange(8, dtype=torch.double) / fps
    seen = torch.zeros(1, 8, dtype=torch.bool)
    unseen = out_of_sight((times[:, None] - times).float(), seen)
    assert (unseen[0] == torch.ones(8, 8).triu(1).bool()).all()


def test_a_hidden_frame_is_seen_by_itself_alone():
    times = torch.arange(4) / 20
    hidden = torch.tensor([[False] * 4, [True, True, False, False]])
    unseen = out_of_sight(times[:, None] - times, hidden)
    assert (unseen[0] == torch.ones(4, 4).triu(1).bool()).all()
    assert (~unseen[1]).nonzero().tolist() == [[0, 0], [1, 1], [2, 2], [3, 2], [3, 3]]


def test_bias_is_interpolated_by_age():
    bias = AgeBias(1)
    bias.table.data = torch.arange(float(N_AGES))[None]
    found = bias(torch.tensor([[0.0, 0.05, 0.125, 1000.0]]))
    expected = torch.tensor([0.0, 1.0, 0.125 / AGE_STEP_S, N_AGES - 1])
    torch.testing.assert_close(found[0, 0], expected, atol=1e-4, rtol=0)


def test_readouts_return_convex_combinations_of_earlier_positions():
    torch.manual_seed(0)
    readout = PositionReadout(16, 5)
    positions = torch.arange(6.0)[None, :, None].expand(1, 6, 3)
    time_s = torch.arange(6) * 0.05
    age_s = time_s[:, None] - time_s
    unseen = out_of_sight(age_s, torch.zeros(1, 6, dtype=torch.bool))
    rows = torch.tensor([[0, 3]])
    points, weights = readout(torch.randn(1, 6, 16), positions, age_s, unseen, rows)
    torch.testing.assert_close(weights @ positions[:, None], points)
    torch.testing.assert_close(points[0, 0], torch.zeros(5, 3))  # nothing but the first frame
    assert (points[0, 1] >= 0).all()
    assert (points[0, 1] <= 3).all()


def test_a_forecast_read_later_says_where_a_target_will_be_that_circles_while_it_falls():
    """Decisions may share one delay, or have one each."""
    delays = torch.arange(8)
    frames = torch.tensor(FORECAST_FRAMES)

    def path(frame: torch.Tensor) -> torch.Tensor:  # [m], at 20 frames a second
        time_s = frame / 20
        turned = 2.5 * time_s
        return torch.stack([0.4 * turned.cos(), 0.4 * turned.sin(), -4.9 * time_s**2], dim=-1)

    forecast = Forecast(
        torch.zeros(1, 8, 1), path(frames).expand(1, 8, -1, 3), torch.ones(1, 8, 1, 1)
    )
    wanted = (frames + delays[:, None]).clamp_max(FORECAST_FRAMES[-1])
    near = wanted <= 20  # a second ahead
    read = forecast.later(delays[None]).places[0]
    torch.testing.assert_close(read[near], path(wanted)[near], atol=0.003, rtol=0)
    for delay in delays:
        torch.testing.assert_close(forecast.later(int(delay)).places[0, delay], read[delay])


def fitted(
    head: ActionHead, context: torch.Tensor, answers: Callable[[], torch.Tensor], steps: int
) -> ActionHead:
    """The head after it has learned answers, which may be drawn anew for each step."""
    weight = torch.ones(len(context), 1)
    fit(head.parameters(), lambda: head.loss(context, answers(), weight).mean(), steps)
    return head.eval()


def two_answers() -> torch.Tensor:
    side = torch.randint(0, 2, (256, 1, 1)) * 2.0 - 1
    return torch.cat([side, torch.zeros_like(side)], dim=-1) + 0.05 * torch.randn(256, 1, 2)


def test_samples_cover_two_answers_and_nothing_between():
    torch.manual_seed(0)
    head = fitted(ActionHead(4, 1, [2], width=64), torch.zeros(256, 4), two_answers, 400)
    with torch.no_grad():
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
    context = torch.zeros(64, 4)
    context[:, 0] = torch.tensor([-1.0, 1.0]).repeat(32)
    actions = context[:, None, :2]
    head = fitted(Gr00tHead(4, 1, [2], **SMALL_GR00T), context, lambda: actions, 100)
    with torch.no_grad():
        right = head.sample(context, 0)[:, 0, 0].sign() == context[:, 0]
    assert right.float().mean() > 0.95
