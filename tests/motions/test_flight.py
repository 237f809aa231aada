"""Thrown and bouncing targets against free flight and the coefficient of restitution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import PHYSICS_DT
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.motions.projectile import Bounce, ThrowMotion
from tests.drawing import draw_motion
from tests.simulation import Track, simulate

THROWS = [name for name, kind in MOTIONS.items() if issubclass(kind, ThrowMotion)]
FLIGHT_S = 0.45
FALL_M_S = GRAVITY_M_S2 * PHYSICS_DT
"""What a step of free fall adds to the speed."""


@pytest.mark.parametrize("kind", THROWS)
@pytest.mark.parametrize("seed", range(4))
def test_a_throw_is_held_then_flies_a_parabola(kind: str, seed: int):
    drawn = draw_motion(kind, seed)
    motion = drawn.motion
    assert isinstance(motion, ThrowMotion)
    track = simulate(motion, drawn.target, motion.release_s + FLIGHT_S)
    released = round(motion.release_s / PHYSICS_DT)
    np.testing.assert_allclose(track.pos[: released + 1] - motion.start, 0.0, atol=1e-9)
    tau = track.time[released:] - track.time[released]
    drop = np.outer(tau**2, [0.0, 0.0, GRAVITY_M_S2 / 2])
    parabola = np.asarray(motion.start) + np.outer(tau, motion.velocity) - drop
    np.testing.assert_allclose(track.pos[released:], parabola, atol=1e-9)


def test_bounces_return_the_stated_share_of_the_speed():
    """The step of the impact leaves out gravity: at most g h of each speed, and none of it on the mean."""
    bounces = [_bounce(seed) for seed in range(24)]
    errors = np.array([bounce.restitution_error for bounce in bounces])
    assert (np.abs(errors) < [FALL_M_S / bounce.impact_m_s for bounce in bounces]).all()
    assert abs(errors.mean()) < 0.003


def test_a_bounce_follows_the_two_parabolas_of_its_impact():
    """The impact is at a step, so it may be late by h: the rebound starts up to (1 + e) v h below the floor."""
    for seed in range(8):
        bounce = _bounce(seed)
        late_m = (1 + bounce.motion.restitution) * bounce.impact_m_s * PHYSICS_DT
        speed_m = 2 * FALL_M_S / bounce.impact_m_s * bounce.apex_m  # of the height, twice the error of the speed
        expected = (bounce.motion.restitution * bounce.impact_m_s) ** 2 / (2 * GRAVITY_M_S2)
        assert -late_m - speed_m < bounce.apex_m - expected < speed_m


@dataclass(frozen=True)
class BounceMeasured:
    """A bounce: its speed at the impact [m/s], rebound speed over it less the stated share, apex over the floor [m]."""

    motion: Bounce
    impact_m_s: float
    restitution_error: float
    apex_m: float


def _bounce(seed: int) -> BounceMeasured:
    drawn = draw_motion("bounce", seed)
    motion = drawn.motion
    assert isinstance(motion, Bounce)
    track = simulate(motion, drawn.target, motion.release_s + 1.0)
    clear = track.pos[:, 2] - drawn.target.rest_height_m
    before = int(np.flatnonzero(clear < 0)[0]) - 1
    after = before + 1 + int(np.flatnonzero(clear[before + 1 :] > 0)[0])
    down, up = _floor_speed(track, clear, before), _floor_speed(track, clear, after)
    return BounceMeasured(motion, down, up / down - motion.restitution, float(clear[after:].max()))


def _floor_speed(track: Track, clear: np.ndarray, k: int) -> float:
    """Vertical speed at the height of the floor [m/s], from the energy at step ``k`` of free flight.

    Semi-implicit Euler keeps the velocity of the middle of the last step.
    """
    return float(np.hypot(track.velocity[k, 2] - FALL_M_S / 2, np.sqrt(2 * GRAVITY_M_S2 * clear[k])))
