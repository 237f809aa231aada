"""The part of an episode on which trajectory quality is measured, as steps between frames."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode

REST_M = 1e-6
"""Palm steps up to this length [m] count as zero: a servo that holds still jitters in the last bits of a float32."""
STILL_M = 1e-3
"""A palm that stays this close [m] to where it is at control start stands still: closing the fingers makes it
recoil by up to 0.4 mm."""


def until_localized(episode: Episode) -> slice:
    """Return the control frames up to and including the first localised one; all of them if none is.

    The paper's trajectory ends when the task is complete, as in the authors' own evaluation.
    """
    first = episode.first_localized
    return slice(episode.meta.window_frames, len(episode) if first is None else first + 1)


def palm_steps(episode: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Return the palm's (M - 1, 3) steps [m] and its (3,) displacement [m] of M trajectory frames.

    Both are zero where the palm stands still.
    """
    points = episode.palm_pos_h[until_localized(episode)].astype(np.float64)  # (M, 3)
    if np.linalg.norm(points - points[0], axis=1).max() <= STILL_M:
        return np.zeros((len(points) - 1, 3)), np.zeros(3)
    steps = np.diff(points, axis=0)
    steps[np.linalg.norm(steps, axis=1) <= REST_M] = 0.0
    displacement = points[-1] - points[0]
    return steps, displacement if np.linalg.norm(displacement) > REST_M else np.zeros(3)
