"""The paper's expert: go straight to where the target will be, at constant speed, and close in time."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.base import EXPERTS, Reach, first_contact_frame
from dynahoi_lerobot.experts.planned import PlannedExpert

RETRY_DELAY_FRAMES = 3
"""Each further attempt aims at a point of the path this much later."""


@EXPERTS.register("intercept")
class Intercept(PlannedExpert):
    """Observe, then a constant-speed straight approach to the oracle intercept (Appendix "Data collection").

    The default intercept is the earliest one that a hand of fixed speed can reach; retries aim later. The hand arrives
    together with the target, so the wait for a planar tolerance that the paper describes is never needed.
    """

    name = "intercept"
    retries = 3

    def plan(self, spec: EpisodeSpec, attempt: int) -> Reach:
        """Return the approach of the ``attempt``-th try (from 1)."""
        return plan_intercept(spec, attempt)


def plan_intercept(spec: EpisodeSpec, attempt: int = 1) -> Reach:
    """Return the approach of the ``attempt``-th try (from 1)."""
    start = spec.window_frames
    last = start + spec.length_frames - 1
    arrival = min(spec.intercept_frame + (attempt - 1) * RETRY_DELAY_FRAMES, last)
    goal = spec.oracle_path[arrival]
    progress = np.linspace(0.0, 1.0, arrival - start + 1)[:, None]
    reach_path = spec.home_pos_w + progress * (goal - spec.home_pos_w)
    closed = first_contact_frame(reach_path, spec.oracle_path[start : arrival + 1], start)
    return Reach(goal, start, arrival, closed, spec.reference_joints)
