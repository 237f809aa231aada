"""Whether the hand is in the reference grasp, or holds the target.

Under the capture rule ``contact`` the target stops the fingers before they reach the reference
grasp, so metrics that compare joint angles with it do not apply there, and S_hold does.
"""

import numpy as np

from dynahoi_lerobot.core import conventions
from dynahoi_lerobot.core.episode import Episode, in_reference_grasp, joints_reached
from dynahoi_lerobot.metrics.base import Compute, metric

BY_CONTACT = "contact"
"""The capture rule that judges a grasp by what touches the target, not by joint angles."""
BY_POSE = f"capture rules other than {BY_CONTACT}"
LOCALIZED_BY_POSE = f"localized episodes, {BY_POSE}"


def judged_by_pose(episode: Episode) -> bool:
    """Tell whether the episode's capture rule judges a grasp by joint angles."""
    return episode.meta.capture != BY_CONTACT


def grasps_within(episode: Episode, frames: int) -> bool | None:
    """Tell whether all 15 joints match the reference in any of ``frames`` frames, counted from the
    first localized one.

    None if the target is never localized, and under the capture rule contact.
    """
    first = episode.first_localized
    if first is None or not judged_by_pose(episode):
        return None
    reached = joints_reached(
        episode.joints[first : first + frames], episode.open_joints, episode.reference_joints
    )
    return bool(reached.all(axis=1).any())


@metric(
    "S_gra", unit="fraction", direction="higher", aggregation="rate", condition=LOCALIZED_BY_POSE
)
def s_gra(episode: Episode) -> bool | None:
    """Grasp success, given localization: all 15 joints match the reference grasp at the first
    localized frame.

    ``S_gra = 1 if for all j: (q_j - open_j) / (ref_j - open_j) >= 0.9, else 0`` with the joint
    angles q at that frame: each joint has turned in the direction of the reference, by at least 0.9
    of its rotation. None if the target is never localized, and under the capture rule contact.

    Fraction of localized episodes, higher is better. Paper: Section "Evaluation metrics" and
    Appendix "Evaluation Criteria".
    """
    return grasps_within(episode, 1)


WINDOW_S = 0.5
"""How long after localization the grasp may close [s]."""


@metric(
    "S_gra_window",
    unit="fraction",
    direction="higher",
    aggregation="rate",
    condition=LOCALIZED_BY_POSE,
)
def s_gra_window(episode: Episode) -> bool | None:
    """Grasp success within 0.5 s, given localization: the test of S_gra on the first localized
    frame and ten more.

    ``S_gra_window = 1 if S_gra's condition holds at any t in [t_loc, t_loc + 0.5 s], else 0``; None
    where S_gra is.

    Fraction of localized episodes, higher is better. Ours: S_gra judges a single frame, so a hand
    that closes 50 ms late fails it.
    """
    return grasps_within(episode, 1 + round(WINDOW_S * conventions.CONTROL_HZ))


@metric(
    "S_gra_two_sided",
    unit="fraction",
    direction="higher",
    aggregation="rate",
    condition=LOCALIZED_BY_POSE,
)
def s_gra_two_sided(episode: Episode) -> bool | None:
    """Grasp success, given localization, with joints neither too open nor too closed.

    ``S_gra_two_sided = 1 if for all j: 0.9 <= (q_j - open_j) / (ref_j - open_j) <= 1.2, else 0``
    with the joint angles q at the first localized frame; joints that the reference leaves open do
    not count. None where S_gra is.

    Fraction of localized episodes, higher is better. Ours: a fist passes the paper's S_gra for
    every object.
    """
    first = episode.first_localized
    if first is None or not judged_by_pose(episode):
        return None
    return bool(
        in_reference_grasp(episode.joints[first], episode.open_joints, episode.reference_joints)
    )


@metric("S_joint", unit="fraction", direction="higher", aggregation="rate", condition=BY_POSE)
def s_joint(episode: Episode) -> bool | None:
    """Joint success: localized, and with joints neither too open nor too closed at the first
    localized frame.

    ``S_joint = S_loc * S_gra_two_sided``, over all episodes: the success of the capture rules that
    weld, and LeRobot's ``next.success`` and ``pc_success`` under them. None under the capture rule
    contact.

    Fraction of episodes, higher is better. Ours: like S_joint_paper, but a fist fails it.
    """
    return _over_all_episodes(episode, s_gra_two_sided(episode))


@metric("S_joint_paper", unit="fraction", direction="higher", aggregation="rate", condition=BY_POSE)
def s_joint_paper(episode: Episode) -> bool | None:
    """Joint success by the paper's grasp: localized, and S_gra's condition holds at the first
    localized frame.

    ``S_joint_paper = S_loc * S_gra``, over all episodes. None under the capture rule contact.

    Fraction of episodes, higher is better. Ours: compare the paper's S_gra column with this metric.
    The paper calls its S_gra conditional, yet prints 0.80 % beside S_loc = 10.30 %: of 103
    localized episodes, one is already 0.97 %.
    """
    return _over_all_episodes(episode, s_gra(episode))


def _over_all_episodes(episode: Episode, grasps: float | None) -> bool | None:
    """Count an episode that never localized as a failure; None where no pose is judged."""
    return bool(grasps) if judged_by_pose(episode) else None


@metric(
    "S_hold",
    unit="fraction",
    direction="higher",
    aggregation="rate",
    condition="capture rule contact",
)
def s_hold(episode: Episode) -> bool | None:
    """Physical capture: the hand holds the free target off every other surface for 0.5 s.

    ``S_hold = 1 if the capture rule contact reports success, else 0``; None under the other rules,
    which weld the target to the palm so that it cannot slip.

    Fraction of episodes under contact, higher is better. Ours.
    """
    return None if judged_by_pose(episode) else episode.success


@metric("E_gra", unit="u", direction="lower", aggregation="mean", bounds=(0.0, float("inf")))
def e_gra(episode: Episode) -> float:
    """Grasping error: the least distance between a fingertip and the target's surface.

    ``E_gra = min_{t, finger} dist(tip(t), surface(t)) / 0.1 m`` over the frames of the control
    phase; 0 inside the target.

    In u (0.1 m), lower is better. Paper: Section "Evaluation metrics".
    """
    return float(episode.fingertip_distance_m[episode.control].min()) / conventions.UNIT_M


FINGERS_AT_LEAST = {"loose": 3, "medium": 4, "strict": 5}
"""Fingers that must match the reference in a frame, by setting of the paper's figure."""


def per_frame_grasp(setting: str, least: int) -> Compute:
    """Return the share of control frames in which so many fingers match the reference grasp, for
    ``metric``.
    """

    def share(episode: Episode) -> float | None:
        if not judged_by_pose(episode):
            return None
        reached = joints_reached(
            episode.joints[episode.control], episode.open_joints, episode.reference_joints
        )
        by_finger = reached.reshape(
            -1, len(conventions.FINGERS), conventions.JOINTS_PER_FINGER
        )  # (T, 5, 3)
        return float(np.mean(by_finger.all(axis=2).sum(axis=1) >= least))

    share.__doc__ = f"""Per-frame grasp, {setting}: the share of control frames in which at least
    {least} fingers match.

    ``grasp_{setting} = mean_t [number of fingers whose three joints all pass the test of
    S_gra at t >= {least}]``. None under the capture rule contact.

    Fraction of frames, higher is better. Paper: Figure "Grasp success rate under per-frame
    evaluation".
    """
    return share


for _setting, _least in FINGERS_AT_LEAST.items():
    _share = metric(
        f"grasp_{_setting}",
        unit="fraction",
        direction="higher",
        aggregation="mean",
        condition=BY_POSE,
    )
    _share(per_frame_grasp(_setting, _least))
