"""Quality control: rules that reject corrupt trajectories (Appendix "Post-processing and quality
control").

Each rule tells whether an episode breaks it. Generation draws a rejected episode again. No intact
recording exceeds the bounds: "seen" is the greatest value in 560 recordings of both capture rules'
experts, with every kind of motion, faster and held-out ones, and disturbances up to the 0.2 m that
recipes allow.
"""

import numpy as np

from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import CONTROL_DT, GANTRY_RANGE_M, PALM_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.core.numerics import runs
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES, is_acting, one_hot_phase
from dynahoi_lerobot.motions.launch import GRAVITY_M_S2

PALM_SLACK_M = 0.005
"""How far soft stops let the palm beyond the range of its slides, to which commands are clipped
(seen: 0.0001)."""
JOINT_RANGE_RAD = (-0.5, 2.0)
"""Least and greatest angle: beyond the 0 to 1.6 that is commanded, what a target that is hit or
gripped bends a finger (seen: -0.23 and 1.62), and room for the joint ranges of other hands."""
CATCH_UP = 2.4
"""Greatest step of the palm between frames, in steps of the servo's ramp, which covers the class's
speed times 0.05 s: a palm that its force limit left one such step behind catches up at twice that,
and a fifth for overshoot (seen: 0.222 m at 2 m/s; at 0.5 m/s 0.0251, and 0.0534 of a label after a
disturbance)."""
OVERSHOOT = 1.2
"""Greatest step of a joint, likewise: 20 rad/s * 0.05 s, and a fifth for contact forces (seen:
0.998 rad)."""
TARGET_SLACK_M = GRAVITY_M_S2 * CONTROL_DT**2 / 2 + 0.025
"""Greatest step of the target beyond the larger of its two speeds times 0.05 s, and beyond the
palm's step, which may carry it: what gravity adds within a frame, and what a collision within it
does (seen: 0.016 together)."""
PALM_SATURATED_SHARE = 0.9
"""Share of the control phase that the palm may be commanded to an end of a slide (seen: 0.66).
Fingers may be commanded to their end in all but the frames of the approach (seen: 0.94)."""
FROZEN_FRAMES = 2
"""Frames in which no degree of freedom may change to the last bit (seen: 0) ..."""
FROZEN_GAP_M = 0.005
"""... while the command is so far away from the palm."""


def broken_rules(episode: Episode) -> list[str]:
    """Return the names of the rules that the episode breaks; no other if it holds NaN or
    infinity.
    """
    if not_finite(episode):
        return ["not_finite"]
    rules = (out_of_limits, jumps, teleports, saturated, frozen, phases_out_of_order)
    return [rule.__name__ for rule in rules if rule(episode)]


def not_finite(episode: Episode) -> str | None:
    """Say which array holds NaN or infinity, if one does."""
    for name, feature in FEATURES.items():
        value = getattr(episode, name)
        if value is not None and not np.isfinite(np.asarray(value, float)).all():
            return f"{feature.key} is not finite"
    return None


def out_of_limits(episode: Episode) -> bool:
    """Tell whether the hand is or should be where it cannot get to."""
    hands = [episode.state, episode.given_action, episode.executed_action]
    if episode.meta.control_mode == JOINTS:  # else a label is a displacement, no place
        hands.append(episode.action)
    palm, joints = np.split(np.concatenate(hands), [PALM_DOF], axis=1)
    low, high = _palm_range(episode)
    least, most = JOINT_RANGE_RAD
    beyond = np.maximum(low - palm, palm - high)  # positive outside
    return bool(beyond.max() > PALM_SLACK_M or joints.min() < least or joints.max() > most)


def jumps(episode: Episode) -> bool:
    """Tell whether the hand makes a step that its servos cannot make within a frame."""
    # imports MuJoCo, which reading a dataset does not need
    from dynahoi_lerobot.captures import CAPTURES

    control = CONTROL_CLASSES[episode.meta.control_class]
    palm_speed_m_s = CAPTURES[episode.meta.capture].palm_speed_m_s(control)
    hands = np.stack([episode.state, episode.given_action, episode.executed_action])
    steps = np.abs(np.diff(hands, axis=1)).max(axis=(0, 1), initial=0.0).astype(float)  # (18,)
    return bool(
        steps[:PALM_DOF].max() > CATCH_UP * palm_speed_m_s * CONTROL_DT
        or steps[PALM_DOF:].max() > OVERSHOOT * control.joint_speed_rad_s * CONTROL_DT
    )


def teleports(episode: Episode) -> bool:
    """Tell whether the target makes a step that neither its own velocity nor a palm that carries it
    explains.
    """
    steps = np.linalg.norm(np.diff(episode.target_pose_h[:, :3], axis=0), axis=1)  # (T - 1,)
    carried = np.linalg.norm(np.diff(episode.palm_pos_h, axis=0), axis=1)
    speed = np.linalg.norm(episode.target_velocity_w[:, :3], axis=1)  # (T,)
    own = np.maximum(speed[1:], speed[:-1]) * CONTROL_DT
    return bool((steps > np.maximum(own, carried) + TARGET_SLACK_M).any())


def saturated(episode: Episode) -> bool:
    """Tell whether the labels of a catch have the palm at a limit of its slides; what was missed
    may well lie beyond it.
    """
    palm = episode.action[is_acting(episode.phase), :PALM_DOF]
    if not episode.success or not len(palm) or episode.meta.control_mode != JOINTS:
        return False
    low, high = _palm_range(episode)
    at_limit = (palm < low + 1e-3) | (palm > high - 1e-3)
    return bool(at_limit.mean(axis=0).max() > PALM_SATURATED_SHARE)


def frozen(episode: Episode) -> bool:
    """Tell whether the measured state stays the same to the last bit while it is commanded
    elsewhere.
    """
    still = (np.diff(episode.state, axis=0) == 0).all(axis=1)  # (T - 1,)
    way = episode.executed_action[:-1, :PALM_DOF] - episode.palm_pos_h[:-1]
    away = np.abs(way).max(axis=1, initial=0.0) > FROZEN_GAP_M
    return any(end - start > FROZEN_FRAMES for start, end in runs(still & away))


def phases_out_of_order(episode: Episode) -> bool:
    """Tell whether phases are not one-hot, or the episode observes again after it began to act."""
    acting = np.maximum.accumulate(is_acting(episode.phase))
    return not np.array_equal(episode.phase, one_hot_phase(acting))


def _palm_range(episode: Episode) -> np.ndarray:
    """(2, 3) least and greatest palm position [m], home frame: the range of the slides."""
    return np.array(GANTRY_RANGE_M).T - episode.home_pos_w.astype(float)
