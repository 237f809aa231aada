"""Every episode belongs to one group of each stratum, the one the paper's bins say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.rows import STRATA
from dynahoi_lerobot.motions.base import CATEGORIES
from tests.synthetic import synthetic_episode

EPISODE = synthetic_episode(image_size=None)
TIERS_AND_PERIODICITIES = {
    "circular_arc": ("kinematic", "circular"),
    "simple_harmonic": ("kinematic", "periodic"),
    "pendulum": ("physical", "periodic"),
    "straight_line": ("kinematic", "linear"),
    "projectile": ("physical", "linear"),
    "inclined_rolling": ("physical", "linear"),
    "impact_response": ("physical", "linear"),
    "hybrid": ("stochastic", "hybrid"),
    "somebody_elses": ("other", "other"),
}


def label(stratum: str, **meta: object) -> str:
    return STRATA[stratum].label(replace(EPISODE, meta=replace(EPISODE.meta, **meta)))


@pytest.mark.parametrize("category", TIERS_AND_PERIODICITIES)
def test_tier_and_periodicity_by_category(category: str):
    names = ("tier", "periodicity")
    assert tuple(label(name, category=category) for name in names) == TIERS_AND_PERIODICITIES[category]
    if category in CATEGORIES:
        assert all(label(name, category=category) in STRATA[name].order for name in (*names, "category"))


@pytest.mark.parametrize(
    ("frames", "expected"),
    [(19, "<20"), (20, "20-40"), (40, "20-40"), (41, "40-60"), (60, "40-60"), (80, "60-80"), (120, "80-120")]
    + [(121, ">120")],
)
def test_duration_bins(frames: int, expected: str):
    assert label("duration", length_frames=frames) == expected


@pytest.mark.parametrize(
    ("distance_m", "expected"),
    [(0.0, "0-0.5"), (0.04, "0-0.5"), (0.06, "0.5-2"), (0.21, "2-4"), (0.39, "2-4"), (0.41, ">4")],
)
def test_travel_is_from_the_palm_at_control_start_to_the_intercept(distance_m: float, expected: str):
    window = EPISODE.meta.window_frames
    goal = EPISODE.palm_pos_h[window] + np.array([0, distance_m, 0], np.float32)
    state = EPISODE.state.copy()
    state[:window, :3] = 50.0
    assert STRATA["travel"].label(replace(EPISODE, state=state, intercept_position=goal)) == expected


def test_known_labels_come_in_order_and_unknown_ones_last():
    assert STRATA["duration"].arrange({">120", "20-40", "odd", "80-120"}) == ["20-40", "80-120", ">120", "odd"]
    assert STRATA["kind"].arrange({"lob", "bounce"}) == ["bounce", "lob"]
