"""The paper's expert: go straight to where the target will be, at constant speed, and close in time."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.agent import Expert, WorldState
from dynahoi_lerobot.conventions import HAND_DOF, PALM_DOF
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.base import EXPERTS, Reach, first_contact_frame, reference_grasp

RETRY_DELAY_FRAMES = 3
"""Each further attempt aims at a point of the path this much later."""


@EXPERTS.register("intercept")
class Intercept(Expert):
    """Observe, then a constant-speed straight approach to the oracle intercept (Appendix "Data collection").

    The default intercept is the earliest one that a hand of fixed speed can reach; retries aim later. The hand arrives
    together with the target, so the wait for a planar tolerance that the paper describes is never needed.
    """

    name = "intercept"
    retries = 3

    def __init__(self) -> None:
        """Start with no plans."""
        self._plans: dict[int, tuple[EpisodeSpec, int, Reach]] = {}

    def act(self, world: WorldState) -> np.ndarray:
        """Return (N, 18) commands; worlds without an episode get zeros."""
        commands = np.zeros((len(world.specs), HAND_DOF))
        for i, spec in enumerate(world.specs):
            if spec is not None:
                palm_pos_w = world.observation.state[i, :PALM_DOF].astype(np.float64)
                commands[i] = self._plan(i, spec, int(world.attempt[i])).command(int(world.frame[i]), palm_pos_w)
        return commands

    def _plan(self, i: int, spec: EpisodeSpec, attempt: int) -> Reach:
        """The approach of world ``i``, planned when its episode or attempt is a new one."""
        known = self._plans.get(i)
        if known is None or known[0] is not spec or known[1] != attempt:
            known = self._plans[i] = spec, attempt, plan_intercept(spec, attempt)
        return known[2]


def plan_intercept(spec: EpisodeSpec, attempt: int = 1) -> Reach:
    """Return the approach of the ``attempt``-th try (from 1)."""
    start = spec.window_frames
    last = start + spec.length_frames - 1
    arrival = min(spec.intercept_frame + (attempt - 1) * RETRY_DELAY_FRAMES, last)
    goal = spec.oracle_path[arrival]
    progress = np.linspace(0.0, 1.0, arrival - start + 1)[:, None]
    reach_path = spec.home_pos_w + progress * (goal - spec.home_pos_w)
    closed = first_contact_frame(reach_path, spec.oracle_path[start : arrival + 1], start)
    return Reach(goal, start, arrival, closed, reference_grasp(spec))
