"""Quality of the palm's path, from control start to the first localized frame."""

import numpy as np

from dynahoi_lerobot.core.conventions import PALM_DOF, UNIT_M
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.metrics.base import metric

REST_M = 1e-6
"""Palm steps up to this length [m] count as zero: a servo that holds still jitters in the last bits
of a float32."""
STILL_M = 1e-3
"""A palm that stays this close [m] to where it is at control start stands still: closing the
fingers makes it recoil by up to 0.4 mm."""


def until_localized(episode: Episode) -> slice:
    """Return the control frames up to and including the first localized one; all of them if none
    is.

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


@metric("Q_line", unit="score", direction="higher", aggregation="mean", bounds=(-1.0, 1.0))
def q_line(episode: Episode) -> float:
    """Spatial linearity of the palm's path from control start to the first localized frame.

    ``Q_line = 1 / (N - 1) * sum_t s_t . v`` with the unit directions ``s_t`` of the steps and ``v``
    of the whole displacement; 0 without displacement or if the palm stays within 1 mm, and a step
    of zero length adds 0.

    Score in [-1, 1], higher is better. Paper: Section "Evaluation metrics".
    """
    return linearity(*palm_steps(episode))


def linearity(steps: np.ndarray, displacement: np.ndarray) -> float:
    """Return the mean cosine between (M, D) steps and the (D,) displacement, 0 where either
    vanishes.
    """
    lengths = np.linalg.norm(steps, axis=1)
    distance = np.linalg.norm(displacement)
    if distance == 0 or len(steps) == 0:
        return 0.0
    cosines = np.divide(
        steps @ displacement, lengths * distance, out=np.zeros(len(steps)), where=lengths > 0
    )
    return float(np.clip(cosines.mean(), -1.0, 1.0))


@metric("Q_smooth", unit="score", direction="higher", aggregation="mean", bounds=(0.0, 1.0))
def q_smooth(episode: Episode) -> float:
    """Temporal smoothness of the palm's path from control start to the first localized frame.

    ``Q_smooth = 1 / (1 + CV(d))`` with ``CV = sigma_d / mu_d`` (population standard deviation) of
    the step lengths ``d_t = |p_{t+1} - p_t|``, and ``CV = 0`` where ``mu_d = 0``: the palm stays
    within 1 mm of where it begins.

    Score in [0, 1], higher is better. Paper: Section "Evaluation metrics".
    """
    return smoothness(palm_steps(episode)[0])


def smoothness(steps: np.ndarray) -> float:
    """Return ``1 / (1 + CV)`` of the lengths of (M, D) steps, 1 where there is no motion."""
    lengths = np.linalg.norm(steps, axis=1)
    if not lengths.any():
        return 1.0
    return float(1.0 / (1.0 + lengths.std() / lengths.mean()))


LEGACY_REST = 1e-4
"""Steps up to this length (u and rad mixed) are dropped, as in the authors' evaluation."""


def command_steps(episode: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Return the (K, 18) steps between successive given commands, tiny ones dropped, and (18,) the
    displacement.

    Palm positions are in u and joint angles in radians, because that mixture is what the authors'
    code measured.
    """
    points = episode.given_action[until_localized(episode)].astype(np.float64)  # (M, 18)
    points[:, :PALM_DOF] /= UNIT_M
    steps = np.diff(points, axis=0)
    return steps[np.linalg.norm(steps, axis=1) > LEGACY_REST], points[-1] - points[0]


@metric("Q_line_18d", unit="score", direction="higher", aggregation="mean", bounds=(-1.0, 1.0))
def q_line_18d(episode: Episode) -> float:
    """Legacy linearity: Q_line on the 18-D commands (palm in u, joints in rad), steps up to 1e-4
    dropped.

    ``Q_line_18d = 1 / (N - 1) * sum_t s_t . v`` with the unit directions of ``a_{t+1} - a_t`` and
    of ``a_N - a_1``, of the commands given (``given_action``), not executed.

    Score in [-1, 1], higher is better. Source: the authors' evaluation code; for comparison with
    their logs only.
    """
    return linearity(*command_steps(episode))


@metric("Q_smooth_18d", unit="score", direction="higher", aggregation="mean", bounds=(0.0, 1.0))
def q_smooth_18d(episode: Episode) -> float:
    """Legacy smoothness: Q_smooth on the 18-D commands (palm in u, joints in rad), steps up to 1e-4
    dropped.

    ``Q_smooth_18d = 1 / (1 + CV(d))`` with ``d_t = |a_{t+1} - a_t|`` of the commands given
    (``given_action``), not executed; 1 without any step, where the authors' value is not a
    number.

    Score in [0, 1], higher is better. Source: the authors' evaluation code; for comparison with
    their logs only.
    """
    return smoothness(command_steps(episode)[0])
