"""Intervals against published values, by coverage, and by determinism."""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.summary import bootstrap, bootstrap_means, wilson


@pytest.mark.parametrize(
    ("successes", "count", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0000, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_matches_published_values(successes: int, count: int, low: float, high: float):
    """Newcombe 1998, Table I, method 3."""
    assert wilson(successes, count) == (pytest.approx(low, abs=6e-5), pytest.approx(high, abs=6e-5))


@pytest.mark.parametrize("count", [1, 7, 110, 1000])
def test_wilson_contains_the_rate_and_mirrors(count: int):
    for successes in {0, 1, count // 2, count}:
        low, high = wilson(successes, count)
        assert 0 <= low <= successes / count <= high <= 1
        assert low < high
        assert wilson(count - successes, count) == (pytest.approx(1 - high), pytest.approx(1 - low))


def test_bootstrap_is_deterministic_blind_to_order_and_draws_from_all_values():
    values = np.random.default_rng(0).normal(size=50)
    assert bootstrap(values) == bootstrap(values[::-1].copy())
    assert bootstrap(values, seed=1) != bootstrap(values)
    assert set(np.round(bootstrap_means(np.array([0.0, 1.0])), 3)) == {0.0, 0.5, 1.0}
    assert len(bootstrap_means(np.zeros(700_000), resamples=3)) == 3  # in pieces of bounded memory


def test_bootstrap_covers_the_true_mean_about_95_times_of_100():
    rng = np.random.default_rng(2)
    samples = (rng.exponential(1.0, 60) for _ in range(200))
    hits = sum(low <= 1.0 <= high for low, high in (bootstrap(sample, resamples=500) for sample in samples))
    assert 0.88 <= hits / 200 <= 0.98
