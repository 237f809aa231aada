"""Thrown and bouncing targets against free flight and the coefficient of restitution."""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.foundation.conventions import PHYSICS_DT
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.bounce import Bounce
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.motions.throw import ThrowMotion
from tests.drawing import draw_motion
from tests.simulation import Track, simulate

THROWS = [name for name, kind in MOTIONS.items() if issubclass(kind, ThrowMotion)]
FLIGHT_S = 0.45


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
    # semi-implicit Euler falls ahead of the parabola by g h t / 2 and by nothing else
    lag = np.outer(tau, [0.0, 0.0, GRAVITY_M_S2 * PHYSICS_DT / 2])
    np.testing.assert_allclose(track.pos[released:], parabola - lag, atol=1e-9)
    assert lag.max() < 0.005


def test_bounces_return_the_stated_share_of_the_speed():
    """At 500 Hz the contact's first step decides how deep it begins: single bounces may be 0.08 off, 0.02 is usual."""
    errors = np.array([_restitution_error(seed) for seed in range(24)])
    assert np.abs(errors).mean() < 0.03
    assert np.abs(errors).max() < 0.08


def _restitution_error(seed: int) -> float:
    drawn = draw_motion("bounce", seed)
    motion = drawn.motion
    assert isinstance(motion, Bounce)
    track = simulate(motion, drawn.target, motion.release_s + 0.6)
    clear = track.pos[:, 2] - drawn.target.rest_height_m
    before = int(np.flatnonzero(clear < 0)[0]) - 1
    after = before + 1 + int(np.flatnonzero((clear[before + 1 :] > 0) & (track.velocity[before + 1 :, 2] > 0))[0])
    return float(_floor_speed(track, clear, after) / _floor_speed(track, clear, before) - motion.restitution)


def _floor_speed(track: Track, clear: np.ndarray, k: int) -> float:
    """Vertical speed at the height of the floor [m/s], from the energy at step ``k`` of free flight."""
    return float(np.sqrt(track.velocity[k, 2] ** 2 + 2 * GRAVITY_M_S2 * clear[k]))
