from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynahoi_lerobot.dataset.statistics import (
    PERCENTS,
    Moments,
    column_stats,
    exact_quantiles,
    picture_histogram,
    picture_stats,
    rank,
    weighted_quantiles,
)

FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


@settings(max_examples=60, deadline=None)
@given(arrays(np.float32, st.tuples(st.integers(1, 60), st.just(2)), elements=FLOATS), st.integers(1, 5))
def test_quantiles_are_those_of_numpy_however_the_data_is_split(values, parts):
    found = exact_quantiles(lambda: np.array_split(values, parts))
    for name, percent in PERCENTS.items():
        expected = np.quantile(values.astype(np.float64), percent / 100, axis=0, method="inverted_cdf")
        np.testing.assert_array_equal(found[name], expected)


def test_rank_does_not_round():
    assert rank(10, 50) == 5  # in floating point 0.1 * 50 rounds up past 5
    assert rank(1, 1) == 1
    assert rank(99, 100) == 99
    assert rank(50, 3) == 2


def test_quantiles_of_nothing_are_refused():
    with pytest.raises(ValueError, match="at least one frame"):
        exact_quantiles(lambda: [])


def test_weighted_quantiles():
    found = weighted_quantiles(np.array([1.0, 5.0, 9.0]), np.array([1, 98, 1]))
    assert found == {"q01": 1.0, "q10": 5.0, "q50": 5.0, "q90": 5.0, "q99": 5.0}


def test_moments_are_those_of_all_values_at_once():
    values = np.random.default_rng(0).normal(3.0, 0.001, (500, 4))
    moments = Moments()
    for part in np.split(values, [7, 80, 300]):
        moments.add(column_stats(part))
    found, expected = moments.stats({}), column_stats(values)
    for name in ("min", "max", "count"):
        np.testing.assert_array_equal(found[name], expected[name])
    np.testing.assert_allclose(found["mean"], expected["mean"], rtol=1e-14)
    np.testing.assert_allclose(found["std"], expected["std"], rtol=1e-10)


def test_picture_statistics_are_those_of_all_pixels():
    images = np.random.default_rng(0).integers(10, 240, (5, 8, 6, 3), np.uint8)
    found = picture_stats(picture_histogram(images), 5)
    pixels = images.reshape(-1, 3) / 255  # (N * H * W, 3)
    np.testing.assert_allclose(found["mean"].ravel(), pixels.mean(axis=0))
    np.testing.assert_allclose(found["std"].ravel(), pixels.std(axis=0))
    np.testing.assert_allclose(found["q10"].ravel(), np.quantile(pixels, 0.1, axis=0, method="inverted_cdf"))
    assert found["count"] == [5]
