"""Struck and rebounding targets against momentum and restitution.

At 500 Hz an impact lasts four or five steps, and where in a step it begins decides how deep: single restitutions are
up to 0.15 off, 0.05 on average.
"""

from __future__ import annotations

import numpy as np
import pytest

from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.base import GRAVITY_M_S2
from dynahoi_lerobot.motions.struck import Struck
from dynahoi_lerobot.motions.wall_rebound import WallRebound
from tests.drawing import draw_motion
from tests.simulation import simulate

SLIDING = MOTIONS["struck"].objects()
SEEDS = range(3)
NEAR_M = 0.002


@pytest.mark.parametrize("name", SLIDING)
def test_a_blow_keeps_momentum_and_returns_the_stated_share_of_the_approach(name: str):
    errors = []
    for seed in SEEDS:
        drawn = draw_motion("struck", seed, name)
        motion = drawn.motion
        assert isinstance(motion, Struck)
        track = simulate(motion, drawn.target, motion.impact_s + 0.2)
        target, striker = track.velocity @ motion.direction(), track.striker_speed
        touched = np.flatnonzero(np.abs(np.diff(striker)) > 1e-6)
        before, after = int(touched[0]), int(touched[-1]) + 1
        assert track.time[before] == pytest.approx(motion.impact_s, abs=0.005)
        # both masses are equal, so momentum is the sum of speeds; the table takes a little while they touch
        assert target[after] + striker[after] == pytest.approx(motion.speed_m_s, rel=0.03)
        aside = track.velocity[after] - target[after] * motion.direction()
        assert np.linalg.norm(aside) < 0.1 * motion.speed_m_s, "the blow is not central"
        errors.append((target[after] - striker[after]) / (striker[before] - target[before]) - motion.restitution)
    assert np.abs(errors).mean() < 0.1
    assert np.abs(errors).max() < 0.15


@pytest.mark.parametrize("name", SLIDING)
def test_a_wall_returns_the_stated_share_of_the_approach(name: str):
    errors = []
    for seed in SEEDS:
        drawn = draw_motion("wall_rebound", seed, name)
        motion = drawn.motion
        assert isinstance(motion, WallRebound)
        track = simulate(motion, drawn.target, motion.impact_s + 0.3)
        speed = track.velocity @ motion.direction()
        gap = (np.asarray(motion.contact) - track.pos) @ motion.direction()
        before = int(np.flatnonzero(gap < NEAR_M)[0]) - 1
        after = before + 1 + int(np.flatnonzero((gap[before + 1 :] > NEAR_M) & (speed[before + 1 :] < 0))[0])
        # the table slows it on the way: allow for the steps between the two measurements
        lost = motion.friction * GRAVITY_M_S2 * (track.time[after] - track.time[before]) / 2
        errors.append((-speed[after] + lost) / (speed[before] - lost) - motion.restitution)
    assert np.abs(errors).mean() < 0.1
    assert np.abs(errors).max() < 0.15


@pytest.mark.parametrize("name", SLIDING)
def test_the_wall_is_met_on_time_and_at_the_stated_speed(name: str):
    for seed in SEEDS:
        drawn = draw_motion("wall_rebound", seed, name)
        motion = drawn.motion
        assert isinstance(motion, WallRebound)
        track = simulate(motion, drawn.target, motion.impact_s + 0.3)
        turned = int(np.flatnonzero(track.velocity @ motion.direction() < 0)[0])
        assert motion.impact_s - 0.15 < track.time[turned] < motion.impact_s + 0.02
        if name != "ball":  # which may begin to roll, and then keeps more
            speed = track.velocity[turned - 12] @ motion.direction()
            assert speed == pytest.approx(motion.speed_m_s, abs=0.03)
