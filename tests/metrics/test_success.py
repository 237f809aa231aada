"""Rates, errors and times against cases small enough to do by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.metrics import METRICS
from tests.metrics.hand_made import WINDOW, hand_made

LINE = [(0.1 * i, 0.0, 1.0) for i in range(5)]
STILL = [(0.0, 0.0, 1.0)] * 5


def with_distance(values: list[float], **changes: object):
    distance = np.array([0.001] * WINDOW + values, np.float32)  # the window's 1 mm must not count
    return replace(hand_made(LINE, **changes), palm_distance=distance, fingertip_distance=distance)


def test_localisation_is_any_localised_control_frame():
    assert METRICS["S_loc"](hand_made(LINE, localized_from=4)) == 1.0
    assert METRICS["S_loc"](hand_made(LINE)) == 0.0


@pytest.mark.parametrize(
    ("offset_m", "capture", "expected"),
    [(0.0, "attach", 1), (0.029, "attach", 1), (0.031, "attach", 0)]
    + [(0.099, "attach_lenient", 1), (0.101, "attach_lenient", 0)],
)
def test_planar_localisation_ignores_height_and_has_the_radius_of_its_track(
    offset_m: float, capture: str, expected: float
):
    episode = hand_made(STILL, target=[(offset_m, 0.0, 4.0)] * 5)
    assert METRICS["S_loc_planar"](replace(episode, meta=replace(episode.meta, capture=capture))) == expected


def test_planar_localisation_in_the_window_does_not_count():
    episode = hand_made(STILL, target=[(9.0, 0.0, 1.0)] * 5)
    episode.target_pose[:WINDOW, :3] = STILL[0]
    assert METRICS["S_loc_planar"](episode) == 0.0


def test_errors_are_least_control_distances_in_units_of_a_decimetre():
    episode = with_distance([0.5, 0.25, 0.06, 0.3, 0.2])
    assert METRICS["E_loc"](episode) == pytest.approx(0.6)
    assert METRICS["E_gra"](episode) == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("joints", "at_once", "within"),
    [
        ([0, 0, 0.91, 0.91, 0.91], 1.0, 1.0),
        ([0, 0, 0.89, 0.91, 0.91], 0.0, 1.0),
        ([1, 1, 0.5, 0.5, 0.5], 0.0, 0.0),  # closed before and open at the arrival: not a grasp
        ([0, 0, -1, -1, -1], 0.0, 0.0),  # far enough, in the wrong direction
    ],
)
def test_the_grasp_is_judged_at_the_first_localised_frame(joints, at_once, within):
    episode = hand_made(LINE, joints=joints, localized_from=2)
    assert METRICS["S_gra"](episode) == at_once
    assert METRICS["S_joint_paper"](episode) == at_once
    assert METRICS["S_gra_window"](episode) == within


def test_one_open_joint_spoils_the_grasp():
    episode = hand_made(LINE, joints=[1] * 5, localized_from=2)
    episode.state[WINDOW + 2, 3 + 7] = 0.0
    assert METRICS["S_gra"](episode) == 0.0


@pytest.mark.parametrize(("closed_frame", "expected"), [(10, 1.0), (11, 0.0)])
def test_the_grasp_window_is_ten_frames_long(closed_frame: int, expected: float):
    joints = [float(frame == closed_frame) for frame in range(14)]
    episode = hand_made([(0.01 * i, 0, 1) for i in range(14)], joints=joints, localized_from=0)
    assert METRICS["S_gra_window"](episode) == expected


def test_a_grasp_is_conditional_on_localisation_and_the_joint_rate_is_not():
    episode = hand_made(LINE, joints=[1] * 5)
    assert METRICS["S_gra"](episode) is None
    assert METRICS["S_gra_window"](episode) is None
    assert METRICS["S_joint"](episode) == 0.0


def test_per_frame_grasp_counts_fingers_with_three_joints_in_place():
    episode = hand_made(LINE)
    closed_fingers = [0, 3, 4, 5, 2]  # per control frame
    for frame, fingers in enumerate(closed_fingers):
        episode.state[WINDOW + frame, 3 : 3 + 3 * fingers] = 1.0
    episode.state[WINDOW + 4, 3 + 6 : 3 + 8] = 1.0  # two of three joints are not a finger
    shares = {name: METRICS[name](episode) for name in ("grasp_loose", "grasp_medium", "grasp_strict")}
    assert shares == {"grasp_loose": 3 / 5, "grasp_medium": 2 / 5, "grasp_strict": 1 / 5}


@pytest.mark.parametrize(
    ("localized_from", "length_frames", "score", "total"),
    [
        (0, 40, 1.0, 1 - 8 / 40),
        (4, 40, 1 - 4 / 40, 1 - 12 / 40),
        (4, 10, 1 - 4 / 10, 0.0),  # clipped: 12 frames from the first one, of 10
        (None, 40, 0.0, 0.0),
    ],
)
def test_time_scores(localized_from, length_frames, score, total):
    episode = hand_made(LINE, localized_from=localized_from, length_frames=length_frames)
    assert METRICS["R_time"](episode) == pytest.approx(score)
    assert METRICS["R_time_total"](episode) == pytest.approx(total)


@pytest.mark.parametrize("success", [True, False])
def test_holding_is_the_verdict_of_the_contact_rule(success: bool):
    episode = replace(hand_made(LINE), success=success)
    contact = replace(episode, meta=replace(episode.meta, capture="contact"))
    assert METRICS["S_hold"](contact) == float(success)
    assert METRICS["S_hold"](episode) is None


@pytest.mark.parametrize(("localized_from", "expected"), [(5, 1.0), (7, 1.0), (8, 0.0), (None, 0.0)])
def test_the_first_opportunity_ends_a_tenth_of_a_second_after_the_intercept(localized_from, expected: float):
    episode = hand_made([(0.1 * i, 0.0, 1.0) for i in range(12)], localized_from=localized_from)
    episode = replace(episode, meta=replace(episode.meta, intercept_frame=WINDOW + 5))
    assert METRICS["S_intercept"](episode) == expected


@pytest.mark.parametrize(("angle", "expected"), [(0.89, 0.0), (0.91, 1.0), (1.19, 1.0), (1.21, 0.0), (-1.0, 0.0)])
def test_a_two_sided_grasp_is_neither_too_open_nor_too_closed(angle: float, expected: float):
    episode = hand_made(LINE, joints=[0.0, 0.0, angle, angle, angle], localized_from=2)
    assert METRICS["S_gra_two_sided"](episode) == METRICS["S_joint"](episode) == expected


def test_a_fist_passes_the_papers_grasp_and_not_the_joint_success():
    episode = hand_made(LINE, joints=[2.0] * 5, localized_from=2)
    assert METRICS["S_gra"](episode) == METRICS["S_joint_paper"](episode) == 1.0
    assert METRICS["S_gra_two_sided"](episode) == METRICS["S_joint"](episode) == 0.0


def test_a_joint_that_the_reference_leaves_open_does_not_count_in_a_two_sided_grasp():
    episode = hand_made(LINE, joints=[1.0] * 5, localized_from=2)
    reference = np.where(np.arange(15) == 3, 0.0, 1.0)
    assert METRICS["S_gra_two_sided"](replace(episode, reference_joints=reference)) == 1.0


def test_relative_speed_is_that_of_the_step_in_which_they_meet():
    episode = hand_made(LINE, localized_from=3)  # the palm moves at 2 m/s along x
    episode.target_velocity[WINDOW + 2, :3] = (2.0, 1.5, 0.0)
    episode.target_velocity[WINDOW + 3, :3] = 9.0  # after the weld
    assert METRICS["relative_speed"](episode) == pytest.approx(1.5, rel=1e-4)
    assert METRICS["relative_speed"](hand_made(LINE)) is None
