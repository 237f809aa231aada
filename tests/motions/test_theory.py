"""Physical motions against the theory of each: free flight, rolling, pendulums, impacts.

An event takes one physics step h, in which gravity adds g h to a speed or leaves it out; tolerances
follow from that.
"""

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import PHYSICS_DT, ROLLING_FRICTION_M
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.inclined_rolling import RollingMotion, rolling_acceleration
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2, heading
from dynahoi_lerobot.motions.pendulum import SuspendedMotion
from dynahoi_lerobot.motions.projectile import ThrowMotion
from dynahoi_lerobot.objects import OBJECTS, TargetObject
from tests.simulation import Drawn, Track, draw_motion, simulate

THROWS, ROLLING = (
    [name for name, kind in MOTIONS.items() if issubclass(kind, base)]
    for base in (ThrowMotion, RollingMotion)
)
ROUND, SLIDING = (
    [n for n, kind in OBJECTS.items() if MOTIONS[motion].suits(kind)]
    for motion in ("ramp", "struck")
)
FALL_M_S = GRAVITY_M_S2 * PHYSICS_DT
"""What a step of free fall adds to the speed."""
SEEDS = range(5)


@pytest.mark.parametrize("kind", THROWS)
def test_a_throw_is_held_then_flies_a_parabola(kind: str):
    for seed in SEEDS:
        drawn = draw_motion(kind, seed)
        motion = drawn.motion
        released = round(drawn.motion.release_s / PHYSICS_DT)
        track = simulate(drawn.motion, drawn.target, motion.release_s + 0.45)
        np.testing.assert_allclose(track.pos[: released + 1] - motion.start, 0.0, atol=1e-9)
        tau = track.time[released:] - track.time[released]
        parabola = np.outer(tau, motion.velocity) - np.outer(tau**2, [0.0, 0.0, GRAVITY_M_S2 / 2])
        np.testing.assert_allclose(track.pos[released:] - motion.start, parabola, atol=1e-9)


def test_bounces_return_the_stated_share_of_the_speed():
    """Speeds at the height of the floor are those of the energy; the mean error is none."""
    errors = []
    for seed in range(24):
        drawn = draw_motion("bounce", seed)
        track = simulate(drawn.motion, drawn.target, drawn.motion.release_s + 1.0)
        clear = track.pos[:, 2] - drawn.target.rest_height_m
        before = int(np.flatnonzero(clear < 0)[0]) - 1
        after = before + 1 + int(np.flatnonzero(clear[before + 1 :] > 0)[0])
        level = [
            np.hypot(track.velocity[k, 2] - FALL_M_S / 2, np.sqrt(2 * GRAVITY_M_S2 * clear[k]))
            for k in (before, after)
        ]
        errors.append(level[1] / level[0] - drawn.motion.restitution)
        assert abs(errors[-1]) < FALL_M_S / level[0]
    assert abs(np.mean(errors)) < 0.003


@pytest.mark.parametrize("kind", ROLLING)
def test_rolls_without_slipping_and_accelerates_as_its_moment_of_inertia_says(kind: str):
    """A step in which the contact is open is free fall: g h along the normal, 1.5 g h sin q along
    the slope.
    """
    errors = []
    for drawn in (draw_motion(kind, seed, name) for name in ROUND for seed in SEEDS):
        motion = drawn.motion
        target = drawn.target
        expected = rolling_acceleration(motion.slope_rad, target)
        rolled_s = np.sqrt(2 * motion.run_m / expected)
        track = simulate(drawn.motion, drawn.target, motion.release_s + 0.95 * rolled_s)
        rolled = (track.time - motion.release_s) / rolled_s
        chosen = (rolled > 0.3) & (rolled < 0.95)
        forward, normal = motion.slope_axes()
        speed = track.velocity[chosen] @ forward
        slip = speed - np.linalg.norm(track.spin[chosen], axis=1) * target.roll_radius_m
        assert np.abs(slip).max() < 1.5 * FALL_M_S * np.sin(motion.slope_rad)
        assert np.abs(track.velocity[chosen] @ normal).max() < FALL_M_S
        errors.append(np.polyfit(track.time[chosen], speed, 1)[0] / expected - 1)
    assert np.abs(errors).max() < 0.004
    assert abs(np.mean(errors)) < 0.001


def test_runs_out_with_the_energy_of_the_ramp():
    """Speed on the level is sqrt(2 a s) less the kink at the foot, which takes 1 - cos q of the
    linear part.
    """
    errors = []
    for drawn in (draw_motion("ramp_and_runout", seed, name) for name in ROUND for seed in SEEDS):
        motion = drawn.motion
        target = drawn.target
        radius = target.roll_radius_m
        acceleration = rolling_acceleration(motion.slope_rad, target)
        ratio = target.inertia[2] / (target.mass_kg * radius**2)
        run_m = motion.run_m - radius * np.tan(
            motion.slope_rad / 2
        )  # it touches the level before its contact does
        track = simulate(
            drawn.motion,
            drawn.target,
            motion.release_s + np.sqrt(2 * motion.run_m / acceleration) + 0.15,
        )
        level_s = track.time[-1] - motion.release_s - np.sqrt(2 * run_m / acceleration)
        kept = (ratio + np.cos(motion.slope_rad)) / (1 + ratio)
        resisted = GRAVITY_M_S2 * ROLLING_FRICTION_M / radius / (1 + ratio) * level_s
        expected = np.sqrt(2 * acceleration * run_m) * kept - resisted
        errors.append(track.velocity[-1] @ np.asarray(heading(motion.yaw_rad)) / expected - 1)
    assert np.abs(errors).max() < 0.01
    assert abs(np.mean(errors)) < 0.002


def arms(drawn: Drawn, track: Track) -> np.ndarray:
    """(K, 3) from the anchor to the target, along a string that keeps its length."""
    arm = track.pos - np.asarray(drawn.motion.anchor)
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), drawn.motion.length_m, atol=2e-4)
    return arm


def swings(drawn: Drawn, track: Track) -> np.ndarray:
    """(K,) angles from the vertical in the plane of the swing, which the target must not leave."""
    arm = arms(drawn, track)
    yaw = drawn.motion.yaw_rad
    assert np.abs(arm @ [-np.sin(yaw), np.cos(yaw), 0.0]).max() < 1e-9
    return np.arctan2(arm @ [np.cos(yaw), np.sin(yaw), 0.0], -arm[:, 2])


def small_period_s(motion: SuspendedMotion, target: TargetObject) -> float:
    """The period of small swings, 2 pi sqrt((I + m l^2) / (m g l))."""
    about_anchor = max(target.inertia[:2]) + target.mass_kg * motion.length_m**2
    return float(
        2 * np.pi * np.sqrt(about_anchor / (target.mass_kg * GRAVITY_M_S2 * motion.length_m))
    )


@pytest.mark.parametrize("angle_rad", [0.02, np.pi / 6, np.pi / 2])
def test_swings_have_the_period_of_the_elliptic_integral(angle_rad: float):
    drawn = draw_motion("planar", 1)
    drawn = replace(drawn, motion=replace(drawn.motion, angle_rad=angle_rad))
    mean = 1.0
    other = float(np.cos(angle_rad / 2))
    for _ in range(30):  # the arithmetic-geometric mean
        mean, other = (mean + other) / 2, np.sqrt(mean * other)
    expected = small_period_s(drawn.motion, drawn.target) / mean
    track = simulate(drawn.motion, drawn.target, 2.6 * expected)
    swing = swings(drawn, track)
    falling = np.flatnonzero((swing[:-1] > 0) & (swing[1:] <= 0))
    times = track.time[falling] + PHYSICS_DT * swing[falling] / (
        swing[falling] - swing[falling + 1]
    )
    assert np.diff(times).mean() == pytest.approx(expected, rel=3e-4)


def test_a_conical_pendulum_circles_at_constant_height_and_rate():
    for seed in SEEDS:
        drawn = draw_motion("conical", seed)
        track = simulate(drawn.motion, drawn.target, 3.0)
        arm = arms(drawn, track)
        assert np.ptp(arm[:, 2]) < 0.001
        angle = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
        rate = (angle[-1] - angle[0]) / track.time[-1]
        assert rate == pytest.approx(drawn.motion.precession_rad_s(drawn.target), rel=1e-3)


def test_drag_shrinks_the_swing_exponentially():
    """The envelope is exp(-s drag t / 2); s is the share of m l^2 in the inertia, as drag acts on
    the center alone.
    """
    drawn = draw_motion("damped", 1)
    motion = replace(drawn.motion, angle_rad=0.2)
    target = drawn.target
    track = simulate(motion, target, 5 * small_period_s(motion, target))
    swing = swings(replace(drawn, motion=motion), track)
    peaks = np.flatnonzero((swing[1:-1] > swing[:-2]) & (swing[1:-1] >= swing[2:])) + 1
    assert len(peaks) >= 3
    about_anchor = target.mass_kg * motion.length_m**2
    share = about_anchor / (about_anchor + max(target.inertia[:2]))
    expected = 0.2 * np.exp(-share * motion.drag_1_s * track.time[peaks] / 2)
    np.testing.assert_allclose(swing[peaks], expected, rtol=0.0015)


def test_a_central_blow_at_the_stated_time_keeps_momentum_and_returns_the_stated_share():
    """Contacts are 0.1 % short of rigid; the table slows by mu g h, and lifts what begins to slide
    at v by mu v.
    """
    errors = []
    for drawn in (draw_motion("struck", seed, name) for name in SLIDING for seed in SEEDS):
        motion = drawn.motion
        track = simulate(drawn.motion, drawn.target, motion.impact_s + 0.2)
        along = track.velocity @ motion.direction()
        striker = track.striker_speed
        touched = np.flatnonzero(np.abs(np.diff(striker)) > 1e-6)
        first = int(touched[0])
        last = int(touched[-1]) + 1
        assert -1e-9 < track.time[first] - motion.impact_s < PHYSICS_DT + 1e-9
        lift = motion.friction * along[last]
        lost = along[first] + striker[first] - along[last] - striker[last]  # both masses are equal
        assert 0 < lost < 1.1 * motion.friction * (FALL_M_S + lift)
        across = track.velocity[last] - along[last] * motion.direction()
        assert across[2] == pytest.approx(lift, rel=0.01)
        assert np.hypot(*across[:2]) < 1e-4, "the blow is not central"
        errors.append(
            (along[last] - striker[last]) / (striker[first] - along[first]) - motion.restitution
        )
    assert np.abs(errors).max() < 0.002
    assert abs(np.mean(errors)) < 0.001


def test_the_wall_is_met_on_time_and_returns_the_stated_share_of_the_stated_speed():
    """Four steps of friction for the speed; a ball that begins to roll on the way stops slowing
    down.
    """
    errors = []
    for name, drawn in (
        (name, draw_motion("wall_rebound", seed, name)) for name in SLIDING for seed in SEEDS
    ):
        motion = drawn.motion
        near_m = 0.002
        track = simulate(drawn.motion, drawn.target, motion.impact_s + 0.3)
        speed = track.velocity @ motion.direction()
        turned = int(np.flatnonzero(speed < 0)[0])
        assert PHYSICS_DT - 1e-9 < track.time[turned] - motion.impact_s < 2 * PHYSICS_DT + 1e-9
        slowed = 4 * motion.friction * FALL_M_S + (0.013 if name == "ball" else 0.0)
        assert speed[turned - 2] == pytest.approx(motion.speed_m_s, abs=slowed)
        gap = (np.asarray(motion.contact) - track.pos) @ motion.direction()
        before = int(np.flatnonzero(gap < near_m)[0]) - 1
        after = (
            before
            + 1
            + int(np.flatnonzero((gap[before + 1 :] > near_m) & (speed[before + 1 :] < 0))[0])
        )
        lost = motion.friction * GRAVITY_M_S2 * (track.time[after] - track.time[before]) / 2
        errors.append((lost - speed[after]) / (speed[before] - lost) - motion.restitution)
    assert np.abs(errors).max() < 0.008
    assert abs(np.mean(errors)) < 0.004
