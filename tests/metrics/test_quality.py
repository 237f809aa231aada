"""Trajectory quality against Section "Evaluation metrics", evaluated in plain Python."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from dynahoi_lerobot.metrics import METRICS
from tests.metrics.hand_made import WINDOW, hand_made


def steps_of(points):
    return [[b - a for a, b in zip(p, q, strict=True)] for p, q in pairwise(points)]


def plain_smoothness(points):
    lengths = [math.sqrt(sum(x * x for x in step)) for step in steps_of(points)]
    mean = sum(lengths) / len(lengths)
    sigma = math.sqrt(sum((length - mean) ** 2 for length in lengths) / len(lengths))
    return 1 / (1 + (sigma / mean if mean else 0.0))


def plain_linearity(points):
    whole = [b - a for a, b in zip(points[0], points[-1], strict=True)]
    size = math.sqrt(sum(x * x for x in whole))
    total = 0.0
    for step in steps_of(points):
        length = math.sqrt(sum(x * x for x in step))
        total += sum(a * b for a, b in zip(step, whole, strict=True)) / (length * size)
    return total / (len(points) - 1)


def random_path(seed: int, points: int = 7) -> list[list[float]]:
    return np.random.default_rng(seed).uniform(-0.3, 0.3, (points, 3)).astype(np.float32).tolist()


@pytest.mark.parametrize("seed", range(5))
def test_quality_is_the_papers_formula_over_the_control_phase(seed: int):
    path = random_path(seed)
    episode = hand_made(path)
    assert METRICS["Q_smooth"](episode) == pytest.approx(plain_smoothness(path), abs=1e-9)
    assert METRICS["Q_line"](episode) == pytest.approx(plain_linearity(path), abs=1e-9)


@pytest.mark.parametrize("localized_from", [1, 2, 5])
def test_the_trajectory_ends_with_the_first_localised_frame(localized_from: int):
    path = random_path(3)
    episode = hand_made(path, localized_from=localized_from)
    assert METRICS["Q_smooth"](episode) == pytest.approx(plain_smoothness(path[: localized_from + 1]), abs=1e-9)
    assert METRICS["Q_line"](episode) == pytest.approx(plain_linearity(path[: localized_from + 1]), abs=1e-9)


def test_a_written_out_case():
    # steps 1 cm along x, 3 cm along y: mean 2, population sigma 1, so CV = 1/2 and Q_smooth = 2/3;
    # the displacement (1, 3) / sqrt(10) has cosines 1/sqrt(10) and 3/sqrt(10), so Q_line = 2/sqrt(10)
    episode = hand_made([(0, 0, 0), (0.01, 0, 0), (0.01, 0.03, 0)])
    assert METRICS["Q_smooth"](episode) == pytest.approx(2 / 3, abs=1e-6)
    assert METRICS["Q_line"](episode) == pytest.approx(2 / math.sqrt(10), abs=1e-6)


@pytest.mark.parametrize("points", [1, 2, 9])
def test_no_motion_is_smooth_and_without_direction(points: int):
    episode = hand_made([(0.2, 0.1, 1.0)] * points)
    for suffix in ("", "_18d"):
        assert METRICS[f"Q_smooth{suffix}"](episode) == 1.0
        assert METRICS[f"Q_line{suffix}"](episode) == 0.0


def test_flicker_of_the_last_bit_is_no_motion():
    flicker = np.nextafter(np.float32(1), np.float32(2))
    episode = hand_made([(1.0, 0, 0), (flicker, 0, 0), (1.0, 0, 0), (flicker, 0, 0)])
    assert METRICS["Q_smooth"](episode) == 1.0
    assert METRICS["Q_line"](episode) == 0.0


@pytest.mark.parametrize(("reach_m", "still"), [(0.0009, True), (0.0011, False)])
def test_a_palm_that_only_recoils_from_the_fingers_stands_still(reach_m: float, still: bool):
    path = [(0, 0, 1.0), (0, reach_m, 1.0), (0, 0, 1.0), (0, 0, 1.0), (0, reach_m / 2, 1.0)]
    episode = hand_made(path)
    assert METRICS["Q_smooth"](episode) == pytest.approx(1.0 if still else plain_smoothness(path), abs=1e-3)
    assert METRICS["Q_line"](episode) == pytest.approx(0.0 if still else 1 / 4, abs=1e-3)


def test_a_pause_adds_nothing_to_linearity_but_counts_as_a_step():
    episode = hand_made([(0, 0, 0), (0.25, 0, 0), (0.25, 0, 0), (0.5, 0, 0)])
    assert METRICS["Q_line"](episode) == pytest.approx(2 / 3)
    assert METRICS["Q_smooth"](episode) == pytest.approx(1 / (1 + math.sqrt(1 / 2)))  # lengths 1, 0, 1


def test_the_window_is_not_part_of_the_trajectory():
    episode = hand_made([(0.125 * i, 0, 0) for i in range(6)])
    episode.state[: WINDOW - 1, :3] = 7.0
    assert METRICS["Q_smooth"](episode) == pytest.approx(1)
    assert METRICS["Q_line"](episode) == pytest.approx(1)


def test_legacy_quality_reads_18d_commands_in_units_and_radians():
    episode = hand_made([(0.0, 0, 0)] * 5)
    commands = [[0.0] * 18 for _ in range(5)]
    for frame, (x_m, angle) in enumerate([(0.0, 0.0), (0.1, 0.0), (0.1, 0.5), (0.100001, 0.5), (0.3, 1.0)]):
        commands[frame][0], commands[frame][3] = x_m, angle
    episode.executed_action[WINDOW:] = commands
    # steps: 1 u; 0.5 rad; 1e-5 u, which is dropped; 2 u and 0.5 rad
    lengths = [1.0, 0.5, math.hypot(2.0, 0.5)]
    mean = sum(lengths) / 3
    sigma = math.sqrt(sum((length - mean) ** 2 for length in lengths) / 3)
    assert METRICS["Q_smooth_18d"](episode) == pytest.approx(1 / (1 + sigma / mean), abs=1e-4)
    whole = math.hypot(3.0, 1.0)  # displacement: 3 u and 1 rad
    cosines = [3 / whole, 1 / whole, (2 * 3 + 0.5 * 1) / (math.hypot(2.0, 0.5) * whole)]
    assert METRICS["Q_line_18d"](episode) == pytest.approx(sum(cosines) / 3, abs=1e-4)
