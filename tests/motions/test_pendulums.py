"""Suspended targets against the compound pendulum: periods, steady precession, decay.

Tolerances are about twice the largest error over twelve draws. What remains is the string, a constraint that gives way
by (g + centripetal acceleration) / (250 rad/s)^2 times its impedance of 0.01, and (h omega)^2 / 24 of the integrator.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.pendulum import ConicalPendulum, SuspendedMotion
from tests.drawing import Drawn, draw_motion
from tests.simulation import Track, simulate

PENDULUMS = [name for name, kind in MOTIONS.items() if issubclass(kind, SuspendedMotion)]
SEEDS = range(3)


@pytest.mark.parametrize("kind", PENDULUMS)
def test_the_string_keeps_its_length(kind: str):
    drawn = draw_motion(kind, 0)
    track = simulate(drawn.motion, drawn.target, 2.0)
    length = np.linalg.norm(_from_anchor(drawn, track), axis=1)
    np.testing.assert_allclose(length, _pendulum(drawn).length_m, atol=5e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_small_swings_have_the_small_period(seed: int):
    drawn = draw_motion("planar", seed)
    drawn = replace(drawn, motion=replace(_pendulum(drawn), angle_rad=0.02))
    expected = _pendulum(drawn).small_period_s(drawn.target)
    assert _period_s(drawn, expected) == pytest.approx(expected, rel=3e-4)


@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 90.0])
def test_large_swings_have_the_period_of_the_elliptic_integral(angle_deg: float):
    drawn = draw_motion("planar", 1)
    angle = float(np.radians(angle_deg))
    drawn = replace(drawn, motion=replace(_pendulum(drawn), angle_rad=angle))
    expected = _pendulum(drawn).small_period_s(drawn.target) / _arithmetic_geometric_mean(1.0, np.cos(angle / 2))
    assert _period_s(drawn, expected) == pytest.approx(expected, rel=3e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_swings_stay_in_their_plane(seed: int):
    drawn = draw_motion("planar", seed)
    yaw = _pendulum(drawn).yaw_rad
    across = _from_anchor(drawn, simulate(drawn.motion, drawn.target, 2.0)) @ [-np.sin(yaw), np.cos(yaw), 0.0]
    assert np.abs(across).max() < 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_a_conical_pendulum_circles_at_constant_height_and_rate(seed: int):
    drawn = draw_motion("conical", seed)
    motion = drawn.motion
    assert isinstance(motion, ConicalPendulum)
    track = simulate(motion, drawn.target, 3.0)
    arm = _from_anchor(drawn, track)
    assert np.ptp(arm[:, 2]) < 0.001
    angle = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    rate = (angle[-1] - angle[0]) / track.time[-1]
    assert rate == pytest.approx(motion.precession_rad_s(drawn.target), rel=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_drag_shrinks_the_swing_exponentially(seed: int):
    """The envelope is exp(-s drag t / 2); s is the share of m l^2 in the inertia, as drag acts on the centre alone."""
    drawn = draw_motion("damped", seed)
    motion, target = replace(_pendulum(drawn), angle_rad=0.2), drawn.target
    drawn = replace(drawn, motion=motion)
    track = simulate(motion, target, 5 * motion.small_period_s(target))
    swing = _swing_angle(drawn, track)
    peaks = np.flatnonzero((swing[1:-1] > swing[:-2]) & (swing[1:-1] >= swing[2:])) + 1
    assert len(peaks) >= 3
    about_anchor = target.mass_kg * motion.length_m**2
    share = about_anchor / (about_anchor + max(target.inertia[:2]))
    expected = 0.2 * np.exp(-share * motion.drag_1_s * track.time[peaks] / 2)
    np.testing.assert_allclose(swing[peaks], expected, rtol=0.0015)


def _pendulum(drawn: Drawn) -> SuspendedMotion:
    assert isinstance(drawn.motion, SuspendedMotion)
    return drawn.motion


def _from_anchor(drawn: Drawn, track: Track) -> np.ndarray:
    return track.pos - np.asarray(_pendulum(drawn).anchor)


def _swing_angle(drawn: Drawn, track: Track) -> np.ndarray:
    arm, yaw = _from_anchor(drawn, track), _pendulum(drawn).yaw_rad
    return np.arctan2(arm @ [np.cos(yaw), np.sin(yaw), 0.0], -arm[:, 2])


def _period_s(drawn: Drawn, about_s: float) -> float:
    """Mean time between falling zero crossings, interpolated."""
    track = simulate(drawn.motion, drawn.target, 2.6 * about_s)
    swing = _swing_angle(drawn, track)
    crossings = np.flatnonzero((swing[:-1] > 0) & (swing[1:] <= 0))
    between = swing[crossings] / (swing[crossings] - swing[crossings + 1])
    times = track.time[crossings] + between * (track.time[1] - track.time[0])
    return float(np.diff(times).mean())


def _arithmetic_geometric_mean(a: float, b: float) -> float:
    for _ in range(30):
        a, b = (a + b) / 2, np.sqrt(a * b)
    return float(a)
