"""Action heads: what they learn of a distribution, and how real-time chunking steers them."""

from __future__ import annotations

import pytest
import torch
from lerobot.policies.rtc import RTCConfig, RTCProcessor
from lerobot_policy_obact.configuration_obact import HEADS
from lerobot_policy_obact.heads import ActionHead, Guidance, most_central

GENERATIVE = ["diffusion", "flow"]


def trained(name: str, target, *, steps: int = 600, horizon: int = 1, groups: tuple[int, ...] = (2,)) -> ActionHead:
    """A head that has learned ``target(n) -> (n, H, A)`` in a context of zeros."""
    torch.manual_seed(0)
    head = HEADS[name](4, horizon, list(groups), width=64)
    optimizer = torch.optim.Adam(head.parameters(), lr=3e-3)
    for _ in range(steps):
        actions = target(256)
        loss = head.loss(torch.zeros(256, 4), actions, torch.ones(256, horizon)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return head.eval()


def two_answers(n: int) -> torch.Tensor:
    side = torch.randint(0, 2, (n, 1, 1)) * 2.0 - 1
    return torch.cat([side, torch.zeros_like(side)], dim=-1) + 0.05 * torch.randn(n, 1, 2)


@pytest.mark.parametrize("name", GENERATIVE)
@torch.no_grad()
def test_samples_cover_two_answers_and_nothing_between(name: str):
    with torch.enable_grad():
        head = trained(name, two_answers)
    head.n_draws = 1
    samples = head.sample(torch.zeros(1000, 4))[:, 0, 0]
    assert 0.4 < (samples > 0.5).float().mean() < 0.6
    assert 0.4 < (samples < -0.5).float().mean() < 0.6


def test_the_draw_nearest_to_the_others_is_taken():
    draws = torch.tensor([[[-1.0, 0.0]], [[1.0, 9.0]], [[1.1, 0.0]]])[None]
    assert torch.equal(most_central(draws, 1), draws[:, 1]), "the second entry does not count"


@torch.no_grad()
def test_regression_answers_with_the_middle():
    with torch.enable_grad():
        head = trained("regression", two_answers)
    first, second = head.sample(torch.zeros(2, 4))
    assert torch.equal(first, second)
    assert first[0, 0].abs() < 1.1
    assert first[0, 1].abs() < 0.1


@pytest.mark.parametrize("name", GENERATIVE)
@torch.no_grad()
def test_noise_is_drawn_anew(name: str):
    head = HEADS[name](4, 3, [2], width=16)
    torch.nn.init.normal_(head.denoiser.out.weight)
    context = torch.zeros(1, 4)
    assert not torch.equal(head.sample(context), head.sample(context))
    noise = head.noise(context)
    assert torch.equal(head.sample(context, noise), head.sample(context, noise))


@pytest.mark.parametrize("name", GENERATIVE)
def test_guidance_continues_the_chunk_before(name: str):
    head = trained(name, lambda n: two_answers(n).expand(-1, 6, -1).clone(), horizon=6)
    processor = RTCProcessor(RTCConfig(enabled=True, execution_horizon=6))
    context = torch.zeros(64, 4)
    leftover = torch.tensor([1.0, 0.0]).expand(64, 4, 2)
    guided = head.sample(context, guidance=Guidance(processor, leftover, 2, None))
    free = head.sample(context)
    assert (guided[:, :2, 0] > 0.5).float().mean() > 0.9
    assert (free[:, :2, 0] > 0.5).float().mean() < 0.7


def test_padding_does_not_count():
    torch.manual_seed(0)
    head = HEADS["regression"](4, 3, [2], width=16)
    context, actions = torch.randn(5, 4), torch.randn(5, 3, 2)
    weight = torch.tensor([1.0, 1.0, 0.0]).expand(5, 3)
    changed = actions.clone()
    changed[:, 2] += 100
    assert torch.equal(head.loss(context, actions, weight), head.loss(context, changed, weight))
