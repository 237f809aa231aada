"""The hand obeys: joints arrive with the frame, limits clip, bad commands harm nothing, the window holds still."""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.rules import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import wait, world

ARRIVAL_PALM_M, ARRIVAL_JOINT_RAD = 0.001, 0.015
"""How close a joint is at the end of the frame, at 1 m/s and 10 rad/s; links pull at each other a little."""


@pytest.fixture
def hands(specs: list[EpisodeSpec]) -> WorldBatch:
    """Four worlds in the control phase."""
    batch = world(specs[:4], control_class="unlimited")
    wait(batch)
    return batch


def test_every_joint_arrives_at_its_command_at_the_end_of_the_frame(hands: WorldBatch):
    rng = np.random.default_rng(1)
    for _ in range(30):
        step = np.hstack([rng.uniform(-0.05, 0.05, (4, PALM_DOF)), rng.uniform(-0.5, 0.5, (4, HAND_DOF - PALM_DOF))])
        wanted = np.clip(hands.executed + step, *hands.command_limits())
        hands.step(wanted)
        np.testing.assert_array_equal(hands.commanded, wanted.astype(np.float32))
        error = np.abs(hands.state - wanted)
        assert error[:, :PALM_DOF].max() < ARRIVAL_PALM_M
        assert error[:, PALM_DOF:].max() < ARRIVAL_JOINT_RAD


def waiting(specs: list[EpisodeSpec], **options) -> WorldBatch:
    """Four worlds whose next command is the first of the control phase, or takes effect then."""
    batch = world(specs[:4], **options)
    while not batch.accepting.all():
        batch.step(batch.executed)
    return batch


@pytest.mark.parametrize("control_class", CONTROL_CLASSES)
def test_palm_and_joints_keep_to_the_speed_limits_and_the_palm_to_its_direction(control_class: str, specs):
    hands, control = waiting(specs, control_class=control_class), CONTROL_CLASSES[control_class]
    direction = np.array([3.0, -2.0, 6.0]) / 7
    before = hands.executed.copy()
    for _ in range(1 + control.latency_frames):
        hands.step(np.hstack([before[:, :PALM_DOF] + 5 * direction * [0.2, 0.2, 0.2], before[:, PALM_DOF:] + 2.0]))
    moved = hands.executed - before
    np.testing.assert_allclose(
        moved[:, :PALM_DOF], np.tile(control.palm_speed_m_s * CONTROL_DT * direction, (4, 1)), rtol=1e-5
    )
    np.testing.assert_allclose(moved[:, PALM_DOF:].max(axis=1), control.joint_speed_rad_s * CONTROL_DT, rtol=1e-5)


def test_a_late_command_takes_effect_three_frames_after_it_was_given(specs: list[EpisodeSpec]):
    hands = waiting(specs, control_class="late")
    home = hands.executed.copy()
    assert not hands.acting.all(), "the window goes on until the first command takes effect"
    hands.step(home + ([0.01] + [0.0] * 17))
    for _ in range(3):
        np.testing.assert_array_equal(hands.executed, home)
        hands.step(home)
    np.testing.assert_allclose(hands.executed[:, 0] - home[:, 0], 0.01, atol=1e-6)
    hands.step(home)
    np.testing.assert_array_equal(hands.executed, home)


def test_under_contact_each_axis_of_the_gantry_has_its_limit(specs: list[EpisodeSpec]):
    hands = waiting(specs, capture="contact", hand="opposed")
    before = hands.executed.copy()
    hands.step(before + ([1.0, -1.0, 0.01] + [0.0] * 15))
    np.testing.assert_allclose(hands.executed - before, np.tile([0.1, -0.1, 0.01] + [0.0] * 15, (4, 1)), atol=1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_commands_beyond_the_range_end_at_its_limit(hands: WorldBatch, side: float):
    for _ in range(60):
        hands.step(np.full((4, HAND_DOF), side * 50.0))
    limit = hands.servo.high if side > 0 else hands.servo.low
    reached = hands.executed + np.hstack([hands.home_pos_w, np.zeros((4, HAND_DOF - PALM_DOF))])
    np.testing.assert_allclose(reached, np.tile(limit, (4, 1)), atol=1e-6)
    np.testing.assert_allclose(hands.state, hands.executed, atol=0.01)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_not_finite_names_world_key_and_value_and_moves_nothing(hands: WorldBatch, value: float):
    commands = hands.executed.copy()
    commands[2, 7] = value
    _assert_refused(hands, commands, rf"action of world 2 must be finite, got {value} at index 7")


@pytest.mark.parametrize("shape", [(3, HAND_DOF), (4, HAND_DOF - 1), (HAND_DOF,), (4, HAND_DOF, 1)])
def test_a_command_of_the_wrong_shape_names_both_shapes_and_moves_nothing(hands: WorldBatch, shape: tuple[int, ...]):
    told = str(shape).replace("(", r"\(").replace(")", r"\)")
    _assert_refused(hands, np.zeros(shape), rf"action must have shape \(4, 18\), got {told}")


def test_bad_commands_are_refused_in_the_window_too(specs: list[EpisodeSpec]):
    batch = world(specs[:4])
    _assert_refused(batch, np.full((4, HAND_DOF), np.nan), "action of world 0 must be finite")


def test_in_the_window_commands_are_ignored_and_the_hand_holds_still(specs: list[EpisodeSpec]):
    batch = world(specs[:8])
    rng = np.random.default_rng(0)
    while not batch.acting.any():
        batch.step(rng.normal(size=(8, HAND_DOF)))
        np.testing.assert_allclose(batch.state, 0.0, atol=1e-4)
    assert not batch.localized.any()


def test_the_phase_turns_with_the_last_frame_of_the_window(specs: list[EpisodeSpec]):
    batch = world(specs[:8])
    for frame in range(12):
        phase = batch.observe(images=False).phase
        expected = [[0, 1] if frame >= spec.window_frames else [1, 0] for spec in specs[:8]]
        np.testing.assert_array_equal(phase, expected)
        batch.step(batch.executed)


def _assert_refused(batch: WorldBatch, commands: np.ndarray, message: str) -> None:
    """The step raises, and not a bit of the batch has changed."""
    state, frame, executed = batch._batch.state.copy(), batch.frame.copy(), batch.executed.copy()
    with pytest.raises(ValueError, match=message):
        batch.step(commands)
    np.testing.assert_array_equal(batch._batch.state, state)
    np.testing.assert_array_equal(batch.frame, frame)
    np.testing.assert_array_equal(batch.executed, executed)
