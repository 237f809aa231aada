"""Rolling targets against rolling without slipping, and energy at the foot of the ramp."""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.geometry import heading
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.motions.rolling import RollingMotion, rolling_acceleration
from dynahoi_lerobot.objects.base import ROLLING_FRICTION_M
from tests.drawing import draw_motion
from tests.simulation import simulate

ROLLING = [name for name, kind in MOTIONS.items() if issubclass(kind, RollingMotion)]
ROUND = MOTIONS["ramp"].objects()


@pytest.mark.parametrize("kind", ROLLING)
@pytest.mark.parametrize("name", ROUND)
def test_accelerates_as_its_moment_of_inertia_says(kind: str, name: str):
    for seed in range(3):
        drawn = draw_motion(kind, seed, name)
        motion = drawn.motion
        assert isinstance(motion, RollingMotion)
        expected = rolling_acceleration(motion.slope_rad, drawn.target)
        rolled_s = np.sqrt(2 * motion.run_m / expected)
        track = simulate(motion, drawn.target, motion.release_s + rolled_s)
        forward, normal = motion.slope_axes()
        slope = (track.time > motion.release_s + 0.3 * rolled_s) & (track.time < motion.release_s + 0.95 * rolled_s)
        speed = track.velocity[slope] @ forward
        measured = (speed[-1] - speed[0]) / (track.time[slope][-1] - track.time[slope][0])
        assert measured == pytest.approx(expected, rel=0.01)
        spin = np.linalg.norm(track.spin[slope], axis=1)
        np.testing.assert_allclose(spin * drawn.target.roll_radius_m, speed, rtol=0.03, err_msg="it slips")
        assert np.abs(track.velocity[slope] @ normal).max() < 0.02, "it leaves the slope"


@pytest.mark.parametrize("solid", [("ball", 2 / 5), ("cylinder", 1 / 2)])
def test_a_solid_ball_and_a_solid_cylinder_have_the_textbook_accelerations(solid: tuple[str, float]):
    name, share = solid
    target = draw_motion("ramp", 0, name).target
    drive = np.sin(0.15) - ROLLING_FRICTION_M / target.roll_radius_m * np.cos(0.15)
    assert rolling_acceleration(0.15, target) == pytest.approx(GRAVITY_M_S2 * drive / (1 + share))


@pytest.mark.parametrize("name", ROUND)
def test_runs_out_with_the_energy_of_the_ramp(name: str):
    """Speed on the level is sqrt(2 a s) less the kink at the foot, which takes 1 - cos q of the linear part."""
    for seed in range(3):
        drawn = draw_motion("ramp_and_runout", seed, name)
        motion, target = drawn.motion, drawn.target
        assert isinstance(motion, RollingMotion)
        acceleration = rolling_acceleration(motion.slope_rad, target)
        rolled_s = np.sqrt(2 * motion.run_m / acceleration)
        track = simulate(motion, target, motion.release_s + rolled_s + 0.15)
        ratio = target.inertia[2] / (target.mass_kg * target.roll_radius_m**2)
        kept = (ratio + np.cos(motion.slope_rad)) / (1 + ratio)
        resisted = GRAVITY_M_S2 * ROLLING_FRICTION_M / target.roll_radius_m / (1 + ratio) * 0.15
        expected = np.sqrt(2 * acceleration * motion.run_m) * kept - resisted
        assert track.velocity[-1] @ np.asarray(heading(motion.yaw_rad)) == pytest.approx(expected, rel=0.05)
        assert abs(track.velocity[-1, 2]) < 0.02, "it does not stay on the level"
