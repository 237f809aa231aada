"""Struck and rebounding targets against momentum and restitution.

An impact takes one physics step. Contacts are 0.1 % short of rigid (each speed off by as much), and the table acts in
that step as well: it slows by mu g h, and, as friction is convex in MuJoCo, lifts what begins to slide at v by mu v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import PHYSICS_DT
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.motions.impact_response import Struck, WallRebound
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2
from dynahoi_lerobot.objects import OBJECTS
from tests.drawing import draw_motion
from tests.simulation import simulate

SLIDING = [name for name, kind in OBJECTS.items() if MOTIONS["struck"].suits(kind)]
SEEDS = range(5)
NEAR_M = 0.002
SOFTNESS = 0.001


@pytest.mark.parametrize("name", SLIDING)
def test_a_central_blow_at_the_stated_time_keeps_momentum(name: str):
    for seed in SEEDS:
        blow = _strike(name, seed)
        assert -1e-9 < blow.time_s - blow.motion.impact_s < PHYSICS_DT + 1e-9
        # both masses are equal, so momentum is the sum of speeds
        lift = blow.motion.friction * blow.after[0]
        lost = sum(blow.before) - sum(blow.after)
        assert 0 < lost < 1.1 * blow.motion.friction * (GRAVITY_M_S2 * PHYSICS_DT + lift)
        assert blow.up == pytest.approx(lift, rel=0.01)
        assert blow.aside < 1e-4, "the blow is not central"


def test_a_blow_returns_the_stated_share_of_the_approach():
    errors = []
    for blow in (_strike(name, seed) for name in SLIDING for seed in SEEDS):
        approach, separation = blow.before[1] - blow.before[0], blow.after[0] - blow.after[1]
        errors.append(separation / approach - blow.motion.restitution)
    assert np.abs(errors).max() < 2 * SOFTNESS
    assert abs(np.mean(errors)) < SOFTNESS


def test_a_wall_returns_the_stated_share_of_the_approach():
    """The table's friction during the impact is mu g h of at least 0.5 m/s, 0.2 %; three times that if a ball spins."""
    errors = [_rebound_error(name, seed) for name in SLIDING for seed in SEEDS]
    assert np.abs(errors).max() < 0.008
    assert abs(np.mean(errors)) < 0.004


@pytest.mark.parametrize("name", SLIDING)
def test_the_wall_is_met_on_time_and_at_the_stated_speed(name: str):
    """The step in which the target arrives and the one that turns it round; four steps of friction for the speed.

    A ball that begins to roll on the way stops slowing down; among 40 balls one did, and was 0.013 m/s faster.
    """
    for seed in SEEDS:
        drawn = draw_motion("wall_rebound", seed, name)
        motion = drawn.motion
        assert isinstance(motion, WallRebound)
        track = simulate(motion, drawn.target, motion.impact_s + 0.3)
        turned = int(np.flatnonzero(track.velocity @ motion.direction() < 0)[0])
        assert PHYSICS_DT - 1e-9 < track.time[turned] - motion.impact_s < 2 * PHYSICS_DT + 1e-9
        error = track.velocity[turned - 2] @ motion.direction() - motion.speed_m_s
        assert abs(error) < 4 * motion.friction * GRAVITY_M_S2 * PHYSICS_DT + (0.013 if name == "ball" else 0.0)


@dataclass(frozen=True)
class Blow:
    """Speeds of target and striker along the blow before and after it; its level speed aside and its speed up [m/s]."""

    motion: Struck
    time_s: float
    before: tuple[float, float]
    after: tuple[float, float]
    aside: float
    up: float


def _strike(name: str, seed: int) -> Blow:
    drawn = draw_motion("struck", seed, name)
    motion = drawn.motion
    assert isinstance(motion, Struck)
    track = simulate(motion, drawn.target, motion.impact_s + 0.2)
    along, striker = track.velocity @ motion.direction(), track.striker_speed
    touched = np.flatnonzero(np.abs(np.diff(striker)) > 1e-6)
    first, last = int(touched[0]), int(touched[-1]) + 1
    across = track.velocity[last] - along[last] * motion.direction()
    before, after = (along[first], striker[first]), (along[last], striker[last])
    return Blow(motion, track.time[first], before, after, float(np.hypot(*across[:2])), float(across[2]))


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
