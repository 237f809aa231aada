"""Rolling targets against rolling without slipping, and energy at the foot of the ramp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import PHYSICS_DT, ROLLING_FRICTION_M
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.inclined_rolling import RollingMotion, rolling_acceleration
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, heading
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from tests.drawing import draw_motion
from tests.simulation import simulate

ROLLING = [name for name, kind in MOTIONS.items() if issubclass(kind, RollingMotion)]
ROUND = [name for name, kind in OBJECTS.items() if MOTIONS["ramp"].suits(kind)]
SEEDS = range(5)
FALL_M_S = GRAVITY_M_S2 * PHYSICS_DT
"""What a step of free fall adds to the speed."""


@pytest.mark.parametrize("kind", ROLLING)
def test_accelerates_as_its_moment_of_inertia_says(kind: str):
    """A step in which the contact is open adds g h sin q to the speed: 0.4 % over a slope, and without a bias."""
    errors = [_slope(kind, name, seed).acceleration_error for name in ROUND for seed in SEEDS]
    assert np.abs(errors).max() < 0.004
    assert abs(np.mean(errors)) < 0.001


@pytest.mark.parametrize("kind", ROLLING)
@pytest.mark.parametrize("name", ROUND)
def test_rolls_without_slipping_or_leaving_the_slope(kind: str, name: str):
    """A step with an open contact is free fall: g h along the normal, g h sin q along the slope (1.5 with the next)."""
    for seed in SEEDS:
        slope = _slope(kind, name, seed)
        assert slope.slip_m_s < 1.5 * FALL_M_S * np.sin(slope.motion.slope_rad)
        assert slope.normal_speed_m_s < FALL_M_S


@pytest.mark.parametrize("solid", [("ball", 2 / 5), ("cylinder", 1 / 2)])
def test_a_solid_ball_and_a_solid_cylinder_have_the_textbook_accelerations(solid: tuple[str, float]):
    name, share = solid
    target = draw_motion("ramp", 0, name).target
    drive = np.sin(0.15) - ROLLING_FRICTION_M / target.roll_radius_m * np.cos(0.15)
    assert rolling_acceleration(0.15, target) == pytest.approx(GRAVITY_M_S2 * drive / (1 + share))


def test_runs_out_with_the_energy_of_the_ramp():
    """Speed on the level is sqrt(2 a s) less the kink at the foot, which takes 1 - cos q of the linear part.

    A contact may be open for a step at the foot as well: g h of about 1 m/s, and less on the mean.
    """
    errors = [_run_out_error(name, seed) for name in ROUND for seed in SEEDS]
    assert np.abs(errors).max() < 0.01
    assert abs(np.mean(errors)) < 0.002


@dataclass(frozen=True)
class Slope:
    """How a target rolled between 30 and 95 % of its time on the slope.

    Attributes:
        acceleration_error: slope of a line through the speeds over the stated acceleration, less 1.
        slip_m_s, normal_speed_m_s: greatest speed of slipping, and across the slope.
    """

    motion: RollingMotion
    acceleration_error: float
    slip_m_s: float
    normal_speed_m_s: float


def _slope(kind: str, name: str, seed: int) -> Slope:
    motion, target = _rolling(kind, name, seed)
    expected = rolling_acceleration(motion.slope_rad, target)
    rolled_s = np.sqrt(2 * motion.run_m / expected)
    track = simulate(motion, target, motion.release_s + rolled_s)
    chosen = (track.time > motion.release_s + 0.3 * rolled_s) & (track.time < motion.release_s + 0.95 * rolled_s)
    forward, normal = motion.slope_axes()
    speed = track.velocity[chosen] @ forward
    spin = np.linalg.norm(track.spin[chosen], axis=1)
    return Slope(
        motion,
        float(np.polyfit(track.time[chosen], speed, 1)[0] / expected - 1),
        float(np.abs(speed - spin * target.roll_radius_m).max()),
        float(np.abs(track.velocity[chosen] @ normal).max()),
    )


def _run_out_error(name: str, seed: int) -> float:
    """Speed 0.15 s after the meeting over the stated one, less 1."""
    motion, target = _rolling("ramp_and_runout", name, seed)
    radius, acceleration = target.roll_radius_m, rolling_acceleration(motion.slope_rad, target)
    ratio = target.inertia[2] / (target.mass_kg * radius**2)
    run_m = motion.run_m - radius * np.tan(motion.slope_rad / 2)  # it touches the level before its contact does
    track = simulate(motion, target, motion.release_s + np.sqrt(2 * motion.run_m / acceleration) + 0.15)
    level_s = track.time[-1] - motion.release_s - np.sqrt(2 * run_m / acceleration)
    kept = (ratio + np.cos(motion.slope_rad)) / (1 + ratio)
    resisted = GRAVITY_M_S2 * ROLLING_FRICTION_M / radius / (1 + ratio) * level_s
    expected = np.sqrt(2 * acceleration * run_m) * kept - resisted
    assert abs(track.velocity[-1, 2]) < FALL_M_S, "it does not stay on the level"
    return float(track.velocity[-1] @ np.asarray(heading(motion.yaw_rad)) / expected - 1)


def _rolling(kind: str, name: str, seed: int) -> tuple[RollingMotion, TargetObject]:
    drawn = draw_motion(kind, seed, name)
    assert isinstance(drawn.motion, RollingMotion)
    return drawn.motion, drawn.target
