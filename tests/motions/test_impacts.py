"""Struck and rebounding targets against momentum and restitution.

At 500 Hz an impact lasts four or five steps, and where in a step it begins decides how deep: single restitutions are
up to 0.15 off, 0.05 on average.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.motions.struck import Struck
from dynahoi_lerobot.motions.wall_rebound import WallRebound
from tests.drawing import draw_motion
from tests.simulation import simulate

SLIDING = MOTIONS["struck"].objects()
SEEDS = range(3)
NEAR_M = 0.002


@pytest.mark.parametrize("name", SLIDING)
def test_a_central_blow_at_the_stated_time_keeps_momentum(name: str):
    for seed in SEEDS:
        blow = _strike(name, seed)
        assert blow.time_s == pytest.approx(blow.motion.impact_s, abs=0.005)
        # both masses are equal, so momentum is the sum of speeds; the table takes a little while they touch
        assert sum(blow.after) == pytest.approx(sum(blow.before), rel=0.03)
        assert blow.aside < 0.1 * blow.motion.speed_m_s, "the blow is not central"


def test_a_blow_returns_the_stated_share_of_the_approach():
    errors = []
    for blow in (_strike(name, seed) for name in SLIDING for seed in SEEDS):
        approach, separation = blow.before[1] - blow.before[0], blow.after[0] - blow.after[1]
        errors.append(separation / approach - blow.motion.restitution)
    assert np.abs(errors).mean() < 0.05
    assert np.abs(errors).max() < 0.15


def test_a_wall_returns_the_stated_share_of_the_approach():
    errors = [_rebound_error(name, seed) for name in SLIDING for seed in SEEDS]
    assert np.abs(errors).mean() < 0.05
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


@dataclass(frozen=True)
class Blow:
    """Speeds along the blow of target and striker before and after it, and the target's speed aside [m/s]."""

    motion: Struck
    time_s: float
    before: tuple[float, float]
    after: tuple[float, float]
    aside: float


def _strike(name: str, seed: int) -> Blow:
    drawn = draw_motion("struck", seed, name)
    motion = drawn.motion
    assert isinstance(motion, Struck)
    track = simulate(motion, drawn.target, motion.impact_s + 0.2)
    along, striker = track.velocity @ motion.direction(), track.striker_speed
    touched = np.flatnonzero(np.abs(np.diff(striker)) > 1e-6)
    first, last = int(touched[0]), int(touched[-1]) + 1
    aside = float(np.linalg.norm(track.velocity[last] - along[last] * motion.direction()))
    return Blow(motion, track.time[first], (along[first], striker[first]), (along[last], striker[last]), aside)


def _rebound_error(name: str, seed: int) -> float:
    """Share of the approach that came back, less the stated one."""
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
    return float((lost - speed[after]) / (speed[before] - lost) - motion.restitution)
