"""Every episode belongs to one group of each stratum, the one the paper's bins say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.strata import STRATA
from dynahoi_lerobot.motions.base import CATEGORIES
from tests.synthetic import synthetic_episode

EPISODE = synthetic_episode(image_size=None)


def label(stratum: str, **meta: object) -> str:
    return STRATA[stratum].label(replace(EPISODE, meta=replace(EPISODE.meta, **meta)))


def test_the_strata_of_the_design():
    assert set(STRATA) >= {"category", "kind", "object", "periodicity", "duration", "travel"}


@pytest.mark.parametrize(
    ("category", "expected"),
    [
        ("circular_arc", "circular"),
        ("simple_harmonic", "periodic"),
        ("pendulum", "periodic"),
        ("straight_line", "linear"),
        ("projectile", "linear"),
        ("inclined_rolling", "linear"),
        ("impact_response", "linear"),
        ("hybrid", "hybrid"),
        ("somebody_elses", "other"),
    ],
)
def test_periodicity_by_category(category: str, expected: str):
    assert label("periodicity", category=category) == expected


def test_every_label_of_a_known_category_has_its_place_in_the_order():
    assert len(CATEGORIES) == 8
    for category in CATEGORIES:
        for name in ("tier", "category", "periodicity"):
            assert label(name, category=category) in STRATA[name].order


@pytest.mark.parametrize(
    ("category", "expected"),
    [("pendulum", "physical"), ("circular_arc", "kinematic"), ("hybrid", "stochastic"), ("somebody_elses", "other")],
)
def test_tier_by_category(category: str, expected: str):
    assert label("tier", category=category) == expected


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        (19, "<20"),
        (20, "20-40"),
        (40, "20-40"),
        (41, "40-60"),
        (60, "40-60"),
        (80, "60-80"),
        (120, "80-120"),
        (121, ">120"),
    ],
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


def test_labels_of_meta_data():
    assert [
        label(name, motion="lob", object="egg", category="projectile") for name in ("kind", "object", "category")
    ] == [
        "lob",
        "egg",
        "projectile",
    ]


def test_known_labels_come_in_order_and_unknown_ones_last():
    assert STRATA["duration"].arrange({">120", "20-40", "odd", "80-120"}) == [
        "20-40",
        "80-120",
        ">120",
        "odd",
    ]
    assert STRATA["kind"].arrange({"lob", "bounce"}) == ["bounce", "lob"]
