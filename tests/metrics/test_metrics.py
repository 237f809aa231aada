"""Every metric against cases small enough to do by hand, and what must hold of all of them."""

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.evaluate.rows import episode_row
from dynahoi_lerobot.metrics import METRICS, Metric, measure, metric
from tests.recompute_metrics import linearity, smoothness
from tests.synthetic import synthetic_episode

WINDOW = 8
LINE = [(0.1 * i, 0.0, 1.0) for i in range(5)]
STILL = [(0.0, 0.0, 1.0)] * 5
FLICKER = (np.nextafter(np.float32(1), np.float32(2)), 0, 0)


def hand_made(
    palm: Sequence[Sequence[float]],
    *,
    target: Sequence[Sequence[float]] | None = None,
    joints: Sequence[float] = (),
    localized_from: int | None = None,
    length_frames: int = 40,
    **changes: object,
) -> Episode:
    """Return an episode that rests for 8 frames and then passes through the ``palm`` positions [m].

    ``joints`` gives one angle [rad] per control frame, taken by all 15 joints (reference 1, open
    0); ``localized_from`` counts from control start.
    """
    points = _after_the_window(palm)
    frames = len(points)
    angles = np.zeros((frames, 15), np.float32)
    angles[WINDOW : WINDOW + len(joints)] = np.array(joints, np.float32)[:, None]
    state = np.hstack([points, angles])
    aim = np.full((frames, 3), 10.0) if target is None else _after_the_window(target)
    localized = np.arange(frames) >= (frames if localized_from is None else WINDOW + localized_from)
    episode = synthetic_episode(frames=40, image_size=None)
    return replace(
        episode,
        meta=replace(episode.meta, window_frames=WINDOW, length_frames=length_frames),
        state=state,
        given_action=np.vstack([state[1:], state[-1:]]),
        target_pose_h=np.hstack([aim, np.tile([1.0, 0, 0, 0], (frames, 1))]).astype(np.float32),
        target_velocity_w=np.zeros((frames, 6), np.float32),
        palm_distance_m=np.linalg.norm(points - aim, axis=1).astype(np.float32),
        fingertip_distance_m=np.full(frames, 0.5, np.float32),
        localized=localized,
        captured=localized,
        **changes,
    )


def _after_the_window(points: Sequence[Sequence[float]]) -> np.ndarray:
    return np.array([points[0]] * WINDOW + list(points), np.float32)


@pytest.mark.parametrize(
    ("offset_m", "capture", "expected"),
    [(0.0, "attach", 1), (0.029, "attach", 1), (0.031, "attach", 0)]
    + [(0.099, "attach_lenient", 1), (0.101, "attach_lenient", 0)],
)
def test_planar_localisation_ignores_height_and_has_the_radius_of_its_track(
    offset_m, capture, expected
):
    episode = hand_made(STILL, target=[(offset_m, 0.0, 4.0)] * 5)
    assert (
        METRICS["S_loc_planar"](replace(episode, meta=replace(episode.meta, capture=capture)))
        == expected
    )


def test_planar_localisation_in_the_window_does_not_count():
    episode = hand_made(STILL, target=[(9.0, 0.0, 1.0)] * 5)
    episode.target_pose_h[:WINDOW, :3] = STILL[0]
    assert METRICS["S_loc_planar"](episode) == 0.0


def test_errors_are_least_control_distances_in_units_of_a_decimetre():
    distance = np.array(
        [0.001] * WINDOW + [0.5, 0.25, 0.06, 0.3, 0.2], np.float32
    )  # the window's 1 mm must not count
    episode = replace(hand_made(LINE), palm_distance_m=distance, fingertip_distance_m=distance)
    assert METRICS["E_loc"](episode) == pytest.approx(0.6)
    assert METRICS["E_gra"](episode) == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("joints", "at_once", "within", "two_sided"),
    [
        ([0, 0, 0.91, 0.91, 0.91], 1, 1, 1),
        ([0, 0, 0.89, 0.91, 0.91], 0, 1, 0),
        ([0, 0, 0.89, 0.89, 0.89], 0, 0, 0),
        ([0, 0, 1.19, 1.19, 1.19], 1, 1, 1),
        ([0, 0, 1.21, 1.21, 1.21], 1, 1, 0),  # a fist
        ([0, 0, 2, 2, 2], 1, 1, 0),
        ([1, 1, 0.5, 0.5, 0.5], 0, 0, 0),  # closed before and open at the arrival: not a grasp
        ([0, 0, -1, -1, -1], 0, 0, 0),  # far enough, in the wrong direction
    ],
)
def test_the_grasp_is_judged_at_the_first_localised_frame(joints, at_once, within, two_sided):
    episode = hand_made(LINE, joints=joints, localized_from=2)
    assert METRICS["S_gra"](episode) == METRICS["S_joint_paper"](episode) == at_once
    assert METRICS["S_gra_window"](episode) == within
    assert METRICS["S_gra_two_sided"](episode) == METRICS["S_joint"](episode) == two_sided


def test_one_open_joint_spoils_the_grasp():
    episode = hand_made(LINE, joints=[1] * 5, localized_from=2)
    episode.state[WINDOW + 2, 3 + 7] = 0.0
    assert METRICS["S_gra"](episode) == 0.0


@pytest.mark.parametrize(("closed_frame", "expected"), [(10, 1.0), (11, 0.0)])
def test_the_grasp_window_is_ten_frames_long(closed_frame: int, expected: float):
    joints = [float(frame == closed_frame) for frame in range(14)]
    episode = hand_made([(0.01 * i, 0, 1) for i in range(14)], joints=joints, localized_from=0)
    assert METRICS["S_gra_window"](episode) == expected


def test_per_frame_grasp_counts_fingers_with_three_joints_in_place():
    episode = hand_made(LINE)
    closed_fingers = [0, 3, 4, 5, 2]  # per control frame
    for frame, fingers in enumerate(closed_fingers):
        episode.state[WINDOW + frame, 3 : 3 + 3 * fingers] = 1.0
    episode.state[WINDOW + 4, 3 + 6 : 3 + 8] = 1.0  # two of three joints are not a finger
    shares = {
        name: METRICS[name](episode) for name in ("grasp_loose", "grasp_medium", "grasp_strict")
    }
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
def test_localisation_is_any_localised_frame_and_the_sooner_the_better(
    localized_from, length_frames, score, total
):
    episode = hand_made(LINE, localized_from=localized_from, length_frames=length_frames)
    assert METRICS["S_loc"](episode) == (localized_from is not None)
    assert METRICS["R_time"](episode) == pytest.approx(score)
    assert METRICS["R_time_total"](episode) == pytest.approx(total)


@pytest.mark.parametrize("success", [True, False])
def test_holding_is_the_verdict_of_the_contact_rule(success: bool):
    episode = replace(hand_made(LINE), success=success)
    contact = replace(episode, meta=replace(episode.meta, capture="contact"))
    assert METRICS["S_hold"](contact) == float(success)
    assert METRICS["S_hold"](episode) is None


@pytest.mark.parametrize(
    ("localized_from", "expected"), [(5, 1.0), (7, 1.0), (8, 0.0), (None, 0.0)]
)
def test_the_first_opportunity_ends_a_tenth_of_a_second_after_the_intercept(
    localized_from, expected: float
):
    episode = hand_made([(0.1 * i, 0.0, 1.0) for i in range(12)], localized_from=localized_from)
    episode = replace(episode, meta=replace(episode.meta, intercept_frame=WINDOW + 5))
    assert METRICS["S_intercept"](episode) == expected


def test_a_joint_that_the_reference_leaves_open_does_not_count_in_a_two_sided_grasp():
    episode = hand_made(LINE, joints=[1.0] * 5, localized_from=2)
    reference = np.where(np.arange(15) == 3, 0.0, 1.0)
    assert METRICS["S_gra_two_sided"](replace(episode, reference_joints=reference)) == 1.0


def test_relative_speed_is_that_of_the_step_in_which_they_meet():
    episode = hand_made(LINE, localized_from=3)  # the palm moves at 2 m/s along x
    episode.target_velocity_w[WINDOW + 2, :3] = (2.0, 1.5, 0.0)
    episode.target_velocity_w[WINDOW + 3, :3] = 9.0  # after the weld
    assert METRICS["relative_speed"](episode) == pytest.approx(1.5, rel=1e-4)
    assert METRICS["relative_speed"](hand_made(LINE)) is None


def random_path(seed: int, points: int = 7) -> np.ndarray:
    # as exact as the episode, in double precision
    return (
        np.random.default_rng(seed).uniform(-0.3, 0.3, (points, 3)).astype(np.float32).astype(float)
    )


@pytest.mark.parametrize(
    ("seed", "localized_from"),
    [*((seed, None) for seed in range(5)), *((3, first) for first in (1, 2, 5))],
)
def test_quality_is_the_papers_formula_over_the_control_phase_to_the_first_localised_frame(
    seed, localized_from
):
    path = random_path(seed)
    episode = hand_made(path, localized_from=localized_from)
    trajectory = path[: (localized_from or len(path)) + 1]
    assert METRICS["Q_smooth"](episode) == pytest.approx(smoothness(trajectory), abs=1e-9)
    assert METRICS["Q_line"](episode) == pytest.approx(linearity(trajectory), abs=1e-9)


@pytest.mark.parametrize(
    "path", [*([(0.2, 0.1, 1.0)] * points for points in (1, 2, 9)), [(1.0, 0, 0), FLICKER] * 2]
)
def test_no_motion_and_flicker_of_the_last_bit_are_smooth_and_without_direction(path: list):
    episode = hand_made(path)
    for suffix in ("", "_18d"):
        assert METRICS[f"Q_smooth{suffix}"](episode) == 1.0
        assert METRICS[f"Q_line{suffix}"](episode) == 0.0


@pytest.mark.parametrize(("reach_m", "still"), [(0.0009, True), (0.0011, False)])
def test_a_palm_that_only_recoils_from_the_fingers_stands_still(reach_m: float, still: bool):
    path = [(0, 0, 1.0), (0, reach_m, 1.0), (0, 0, 1.0), (0, 0, 1.0), (0, reach_m / 2, 1.0)]
    episode = hand_made(path)
    assert METRICS["Q_smooth"](episode) == pytest.approx(
        1.0 if still else smoothness(np.array(path)), abs=1e-3
    )
    assert METRICS["Q_line"](episode) == pytest.approx(0.0 if still else 1 / 4, abs=1e-3)


def test_legacy_quality_reads_18d_commands_in_units_and_radians():
    episode = hand_made([(0.0, 0, 0)] * 5)
    commands = [[0.0] * 18 for _ in range(5)]
    for frame, (x_m, angle) in enumerate(
        [(0.0, 0.0), (0.1, 0.0), (0.1, 0.5), (0.100001, 0.5), (0.3, 1.0)]
    ):
        commands[frame][0] = x_m
        commands[frame][3] = angle
    episode.given_action[WINDOW:] = commands
    # steps: 1 u; 0.5 rad; 1e-5 u, which is dropped; 2 u and 0.5 rad
    lengths = [1.0, 0.5, math.hypot(2.0, 0.5)]
    mean = sum(lengths) / 3
    sigma = math.sqrt(sum((length - mean) ** 2 for length in lengths) / 3)
    assert METRICS["Q_smooth_18d"](episode) == pytest.approx(1 / (1 + sigma / mean), abs=1e-4)
    whole = math.hypot(3.0, 1.0)  # displacement: 3 u and 1 rad
    cosines = [3 / whole, 1 / whole, (2 * 3 + 0.5 * 1) / (math.hypot(2.0, 0.5) * whole)]
    assert METRICS["Q_line_18d"](episode) == pytest.approx(sum(cosines) / 3, abs=1e-4)


def wild_episode(seed: int):
    """Return an episode of noise: any path, any joints, localized anywhere or never."""
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(1, 30))
    start = None if rng.random() < 0.3 else int(rng.integers(frames))
    palm = rng.normal(0, 1, (frames, 3)) * rng.choice([0.0, 1e-7, 0.1, 10.0])
    episode = hand_made(
        palm.tolist(),
        joints=rng.normal(1, 1, frames).tolist(),
        localized_from=start,
        stage="missed",
    )
    capture = str(rng.choice(["attach", "attach_lenient", "contact"]))
    return replace(episode, meta=replace(episode.meta, capture=capture))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_values_are_in_range_and_order_or_none_where_conditional_and_change_nothing(seed: int):
    episode = wild_episode(seed)
    arrays = {field.name: getattr(episode, field.name) for field in fields(episode)}
    before = {
        name: array.tobytes() for name, array in arrays.items() if isinstance(array, np.ndarray)
    }
    for name in before:
        arrays[name].setflags(write=False)
    value = measure(episode)
    assert value == measure(episode)
    assert before == {name: getattr(episode, name).tobytes() for name in before}
    for name, found in value.items():
        entry = METRICS[name]
        if found is None:
            assert entry.condition, f"{name} has no condition, so it must have a value"
            continue
        assert isinstance(found, float)
        low, high = entry.bounds
        assert math.isfinite(found)
        assert low <= found <= high, name
        assert entry.aggregation == "mean" or found in (0.0, 1.0)
    assert value["S_loc"] <= value["S_loc_planar"]
    assert value["R_time_total"] <= value["R_time"]
    if episode.meta.capture == "contact":
        return
    assert value["S_joint"] <= value["S_joint_paper"] <= value["S_loc"]
    assert value["grasp_strict"] <= value["grasp_medium"] <= value["grasp_loose"]
    assert (value["S_gra"] is None) == (value["S_loc"] == 0)
    assert value["S_gra"] is None or value["S_gra"] <= value["S_gra_window"]


OF_THE_REFERENCE_GRASP = {
    "S_gra",
    "S_gra_window",
    "S_gra_two_sided",
    "S_joint",
    "S_joint_paper",
    "grasp_loose",
    "grasp_medium",
    "grasp_strict",
}


@pytest.mark.parametrize("localized_from", [None, 2])
def test_contact_has_a_hold_and_no_reference_grasp_and_the_other_rules_the_reverse(localized_from):
    episode = hand_made(LINE, joints=[1.0] * 5, localized_from=localized_from, stage="missed")
    for capture in ("attach", "attach_lenient", "contact"):
        value = measure(replace(episode, meta=replace(episode.meta, capture=capture)))
        empty = {name for name, found in value.items() if found is None}
        conditional = {
            name
            for name, entry in METRICS.items()
            if entry.condition.startswith("localized") and localized_from is None
        }
        apart = OF_THE_REFERENCE_GRASP if capture == "contact" else {"S_hold"}
        assert empty == apart | conditional


@pytest.mark.parametrize(
    ("value", "aggregation", "bounds"),
    [
        (1.5, "mean", (0.0, 1.0)),
        (0.5, "rate", (0.0, 1.0)),
        (float("inf"), "mean", (0.0, float("inf"))),
    ],
)
def test_a_value_that_its_own_decorator_excludes_is_refused_when_it_is_measured(
    value: float, aggregation: str, bounds: tuple
):
    """Written into results, it would make them unreadable."""
    odd = Metric("V_palm", lambda _: value, "score", "higher", aggregation, bounds)
    with pytest.raises(ValueError, match=f"V_palm of seed 0 is {value}.* or return None"):
        odd(hand_made(LINE))


@pytest.mark.parametrize(
    ("unit", "aggregation", "admitted"),
    [
        ("m/s^2", "mean", [-15.0, 0.0, 0.5, 1.0, 15.0]),
        ("fraction", "mean", [0.0, 0.5, 1.0]),
        ("score", "rate", [0.0, 1.0]),
    ],
)
def test_a_quantity_has_no_bounds_unless_given_and_a_share_has_0_and_1(
    unit: str, aggregation: str, admitted: list, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(METRICS, "register", lambda name: lambda entry: entry)
    one = metric("V_palm", unit=unit, direction="lower", aggregation=aggregation)(lambda _: 0.0)
    values = [-15.0, 0.0, 0.5, 1.0, 15.0, float("nan"), float("inf")]
    assert [value for value in values if one.admits(value)] == admitted


def test_an_unknown_direction_or_aggregation_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="unknown direction 'up'; known: higher, lower"):
        metric("V_palm", unit="s", direction="up", aggregation="mean")
    with pytest.raises(ValueError, match=r"unknown aggregation 'median'.*; known: rate, mean"):
        metric("V_palm", unit="s", direction="lower", aggregation="median")


@pytest.mark.parametrize(
    "name", ["commands", *sorted(episode_row(hand_made(LINE)).keys() - METRICS.names())]
)
def test_a_metric_cannot_take_the_name_of_a_column_of_results(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(METRICS, "register", lambda name: lambda entry: entry)
    with pytest.raises(ValueError, match=f"cannot be named '{name}'.* reserved: .*\\b{name}\\b"):
        metric(name, unit="s", direction="lower", aggregation="mean")


@pytest.mark.parametrize("name", METRICS.names())
def test_a_metric_does_not_depend_on_where_the_world_has_its_origin_or_heading(name: str):
    episode = synthetic_episode(seed=3, miss_m=0.02, image_size=None)
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    state = episode.state.copy()
    action = episode.action.copy()
    pose = episode.target_pose_h.copy()
    for array in (state, action, pose):
        array[:, :3] = array[:, :3] @ turn.T + np.float32([0.25, -0.5, 0.5])
    velocity = np.hstack(
        [episode.target_velocity_w[:, :3] @ turn.T, episode.target_velocity_w[:, 3:] @ turn.T]
    )
    moved = replace(
        episode, state=state, action=action, target_pose_h=pose, target_velocity_w=velocity
    )
    assert METRICS[name](moved) == pytest.approx(METRICS[name](episode), abs=1e-4)
