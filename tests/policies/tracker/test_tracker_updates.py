"""One update of weights: its learning rate, its clipped gradients, and the loss that it refuses."""

from __future__ import annotations

import pytest
import torch
from lerobot_policy_tracker.updates import learning_rate, take_step
from torch import nn


def test_the_rate_warms_up_and_decays_to_a_fiftieth():
    rates = [learning_rate(1.0, update, 1000, warmup=50) for update in range(1001)]
    assert rates[0] == pytest.approx(0.02, rel=1e-3)
    assert max(rates) == pytest.approx(1.0, abs=0.01)
    assert rates.index(max(rates)) == 49
    assert rates[1000] == pytest.approx(0.02)


def test_a_step_follows_clipped_gradients_at_the_rate_it_is_given():
    weight = nn.Parameter(torch.tensor([3.0, 4.0]))
    optimizer = torch.optim.SGD([weight], lr=0.0)
    loss = take_step(optimizer, 50 * weight.square().sum(), [weight], max_norm=1.0, rate=0.5, n=0)
    assert loss == pytest.approx(1250.0)
    torch.testing.assert_close(weight.detach(), torch.tensor([3.0 - 0.3, 4.0 - 0.4]))


def test_a_loss_that_is_not_finite_changes_nothing():
    weight = nn.Parameter(torch.tensor([1.0]))
    optimizer = torch.optim.SGD([weight], lr=0.0)
    with pytest.raises(FloatingPointError, match="the loss of update 7 is nan; lower learning_rate"):
        take_step(optimizer, (weight * float("nan")).sum(), [weight], max_norm=1.0, rate=0.5, n=7)
    assert weight.item() == 1.0
