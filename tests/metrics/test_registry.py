"""What must hold of every registered metric, with no line per metric."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahoi_lerobot.metrics import METRICS, measure
from tests.metrics.hand_made import hand_made
from tests.synthetic import synthetic_episode

NAMES = METRICS.names()


def wild_episode(seed: int):
    """Return an episode of noise: any path, any joints, localised anywhere or never."""
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(1, 30))
    start = None if rng.random() < 0.3 else int(rng.integers(frames))
    palm = rng.normal(0, 1, (frames, 3)) * rng.choice([0.0, 1e-7, 0.1, 10.0])
    episode = hand_made(palm.tolist(), joints=rng.normal(1, 1, frames).tolist(), localized_from=start, stage="missed")
    capture = str(rng.choice(["attach", "attach_lenient", "contact"]))
    return replace(episode, meta=replace(episode.meta, capture=capture))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_values_are_in_range_or_none_where_conditional(seed: int):
    episode = wild_episode(seed)
    for name, value in measure(episode).items():
        metric = METRICS[name]
        if value is None:
            assert metric.condition, f"{name} has no condition, so it must have a value"
            continue
        assert isinstance(value, float)
        assert math.isfinite(value), name
        low, high = metric.bounds
        assert low <= value <= high, name
        assert metric.aggregation == "mean" or value in (0.0, 1.0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_metrics_are_pure(seed: int):
    episode = wild_episode(seed)
    arrays = {f.name: getattr(episode, f.name) for f in fields(episode)}
    before = {name: value.tobytes() for name, value in arrays.items() if isinstance(value, np.ndarray)}
    for value in arrays.values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    assert measure(episode) == measure(episode)
    assert before == {name: getattr(episode, name).tobytes() for name in before}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_between_related_metrics(seed: int):
    value = measure(wild_episode(seed))
    assert value["S_joint"] <= value["S_joint_paper"] <= value["S_loc"] <= value["S_loc_planar"]
    assert value["R_time_total"] <= value["R_time"]
    assert value["grasp_strict"] <= value["grasp_medium"] <= value["grasp_loose"]
    assert (value["S_gra"] is None) == (value["S_loc"] == 0)
    assert value["S_gra"] is None or value["S_gra"] <= value["S_gra_window"]


@pytest.mark.parametrize("name", NAMES)
def test_a_metric_does_not_depend_on_where_the_world_has_its_origin_or_heading(name: str):
    episode = synthetic_episode(seed=3, miss_m=0.02, image_size=None)
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    state, action, pose = episode.state.copy(), episode.action.copy(), episode.target_pose.copy()
    for array in (state, action, pose):
        array[:, :3] = array[:, :3] @ turn.T + np.float32([0.25, -0.5, 0.5])
    velocity = np.hstack([episode.target_velocity[:, :3] @ turn.T, episode.target_velocity[:, 3:] @ turn.T])
    moved = replace(episode, state=state, action=action, target_pose=pose, target_velocity=velocity)
    assert METRICS[name](moved) == pytest.approx(METRICS[name](episode), abs=1e-4)
