"""Whether, where and when the palm reaches the target."""

import numpy as np

from dynahoi_lerobot.core.conventions import (
    CONTROL_DT,
    CONTROL_HZ,
    UNIT_M,
)
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.metrics.base import metric
from dynahoi_lerobot.metrics.trajectory import until_localized


@metric("S_loc", unit="fraction", direction="higher", aggregation="rate")
def s_loc(episode: Episode) -> bool:
    """Localization success: the palm center comes within 0.3 u (0.03 m) of the target center.

    ``S_loc = 1 if exists t >= t_control: |palm(t) - target(t)| < 0.3 u, else 0``, the 3-D distance,
    checked between frames as well. Under the capture rule attach_lenient the threshold is 1.0 u
    (S_loc* of the paper's table of vision-language models), here and in every metric that depends
    on localization.

    Fraction of episodes, higher is better. Paper: Section "Evaluation metrics", threshold from
    Appendix "Evaluation Criteria".
    """
    return episode.first_localized is not None


@metric("S_loc_planar", unit="fraction", direction="higher", aggregation="rate")
def s_loc_planar(episode: Episode) -> bool:
    """Planar localization: the horizontal distance of palm and target center falls below 0.3 u
    (0.03 m).

    ``S_loc_planar = 1 if exists t: |(palm(t) - target(t))_xy| < 0.3 u, else 0`` over the control
    frames until the target is attached. 3-D localization implies it, also between two frames. Under
    attach_lenient the threshold is 1.0 u.

    Fraction of episodes, higher is better. Source: the authors' evaluation code, which ignores
    height, although the paper's Section "Evaluation metrics" says distance.
    """
    if episode.first_localized is not None:
        return True
    from dynahoi_lerobot.captures import CAPTURES  # which brings in MuJoCo

    frames = until_localized(episode)
    offset = episode.palm_pos_h[frames, :2] - episode.target_pose_h[frames, :2]  # (T, 2)
    radius_m = CAPTURES[episode.meta.capture].localization_radius_m
    return bool((np.linalg.norm(offset, axis=1) < radius_m).any())


INTERCEPT_TOLERANCE_FRAMES = round(0.1 * CONTROL_HZ)
"""A target localized this long after the oracle's intercept, 0.1 s, still counts as intercepted."""


@metric("S_intercept", unit="fraction", direction="higher", aggregation="rate")
def s_intercept(episode: Episode) -> bool:
    """Localization at the first opportunity: no later than 0.1 s after the oracle's intercept.

    ``S_intercept = 1 if t_loc <= t_intercept + 0.1 s, else 0`` with ``t_loc`` the first localized
    frame of the control phase and ``t_intercept`` the earliest at which a hand of 0.3 m/s can meet
    the target.

    Fraction of episodes, higher is better. Ours: a hand that chases its target and catches it later
    needs no prediction.
    """
    first = episode.first_localized
    return first is not None and first <= episode.meta.intercept_frame + INTERCEPT_TOLERANCE_FRAMES


@metric("E_loc", unit="u", direction="lower", aggregation="mean", bounds=(0.0, float("inf")))
def e_loc(episode: Episode) -> float:
    """Localization error: the least distance between palm center and target center.

    ``E_loc = min_t |palm(t) - target(t)| / 0.1 m`` over the frames of the control phase.

    In u (0.1 m), lower is better. Paper: Section "Evaluation metrics".
    """
    return float(episode.palm_distance_m[episode.control].min()) / UNIT_M


@metric(
    "relative_speed",
    unit="m/s",
    direction="lower",
    aggregation="mean",
    bounds=(0.0, float("inf")),
    condition="localized episodes",
)
def relative_speed(episode: Episode) -> float | None:
    """Relative speed of palm and target at localization.

    ``relative_speed = |v_target(t - 1) - (palm(t) - palm(t - 1)) / 0.05 s|`` with t the first
    localized frame. The target's velocity is taken one frame earlier, because at t a welded target
    already moves with the palm. None if the target is never localized.

    In m/s, lower is better. Ours: ``attach`` catches at any relative speed, which no real hand can.
    """
    first = episode.first_localized
    if first is None:
        return None
    palm_velocity = (episode.palm_pos_h[first] - episode.palm_pos_h[first - 1]) / CONTROL_DT
    return float(np.linalg.norm(episode.target_velocity_w[first - 1, :3] - palm_velocity))


@metric("R_time", unit="score", direction="higher", aggregation="mean", bounds=(0.0, 1.0))
def r_time(episode: Episode) -> float:
    """Time score, counted from control start; 0 if the target is never localized.

    ``R_time = 1 - T / N``, clipped to [0, 1], with N the recording's length [frames] and T the
    frames from control start to the first localized one.

    Score in [0, 1], higher is better. Paper: Section "Evaluation metrics"; the start of the clock
    follows the authors' evaluation code.
    """
    return time_score(episode, start_frame=episode.meta.window_frames)


def time_score(episode: Episode, start_frame: int) -> float:
    """Return ``1 - (first localized frame - start_frame) / length_frames`` in [0, 1], 0 if there is
    none.
    """
    first = episode.first_localized
    if first is None:
        return 0.0
    return float(np.clip(1 - (first - start_frame) / episode.meta.length_frames, 0.0, 1.0))


@metric("R_time_total", unit="score", direction="higher", aggregation="mean", bounds=(0.0, 1.0))
def r_time_total(episode: Episode) -> float:
    """Time score, counted from the first frame, so that observing costs time too; 0 if the target
    is never localized.

    ``R_time_total = 1 - T / N``, clipped to [0, 1], with N the recording's length and T the frames
    from the episode's start to the first localized one.

    Score in [0, 1], higher is better. Ours: the other reading of the paper's Section "Evaluation
    metrics".
    """
    return time_score(episode, start_frame=0)
