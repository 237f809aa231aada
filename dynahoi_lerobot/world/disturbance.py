"""Pushes: what makes a hand stray from where it was told to go, so that demonstrations show how to come back.

A policy that only ever saw an undisturbed expert does not know what to do after its own first mistake. Disturbing the
expert and keeping its commands, not what became of them, shows it (Laskey et al., 2017).
"""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import PALM_DOF

DISTURBED_SHARE = 0.3
"""Share of the frames of the control phase that are pushed."""


def draw_disturbance(spec: EpisodeSpec, attempt: int, spread_m: float) -> np.ndarray:
    """Return (F, 3) how far each frame's palm command is missed [m], world; zero in the window and after the intercept.

    Args:
        spec: the episode; with ``attempt`` it decides every draw.
        attempt: from 1.
        spread_m: standard deviation of a push along each axis [m].
    """
    rng = np.random.default_rng([0xD157, spec.seed, attempt])
    pushes = rng.normal(0.0, spread_m, (len(spec.oracle_path), PALM_DOF))
    pushes[rng.random(len(pushes)) >= DISTURBED_SHARE] = 0.0
    pushes[: spec.window_frames] = 0.0
    pushes[spec.intercept_frame - 1 :] = 0.0  # the last command before the intercept is met, or nothing is caught
    return pushes
