"""The part of an episode on which trajectory quality is measured, as steps between frames."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode

REST_M = 1e-6
"""Palm steps up to this length [m] count as zero: a servo that holds still jitters in the last bits of a float32."""


def until_localized(episode: Episode) -> slice:
    """Return the control frames up to and including the first localised one; all of them if none is.

    The paper's trajectory ends when the task is complete, as in the authors' own evaluation.
    """
    first = episode.first_localized
    return slice(episode.meta.window_frames, len(episode) if first is None else first + 1)


def palm_steps(episode: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Return the palm's (M - 1, 3) steps [m] and its (3,) displacement [m] of M trajectory frames."""
    points = episode.palm_pos_h[until_localized(episode)].astype(np.float64)  # (M, 3)
    steps = np.diff(points, axis=0)
    steps[np.linalg.norm(steps, axis=1) <= REST_M] = 0.0
    displacement = points[-1] - points[0]
    return steps, displacement if np.linalg.norm(displacement) > REST_M else np.zeros(3)
