"""Quality control: rules that reject corrupt trajectories (Appendix "Post-processing and quality
control").

Each rule looks at one episode and returns a sentence about what is wrong, or None. Generation draws
a rejected episode again. No intact recording exceeds the bounds: "seen" is the greatest value in
560 recordings of both capture rules' experts, with every kind of motion, faster and held-out ones,
and disturbances up to the 0.2 m that recipes allow.
"""

import numpy as np

from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.conventions import CONTROL_DT, GANTRY_RANGE_M, HAND_DOF, PALM_DOF
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


def trajectory_problems(episode: Episode) -> list[str]:
    """Return a sentence for each rule that the episode breaks; only the first if it holds NaN or
    infinity.
    """
    problem = not_finite(episode)
    if problem:
        return [problem]
    rules = (out_of_limits, jumps, teleports, saturation, frozen, phase_order)
    return list(filter(None, (rule(episode) for rule in rules)))


def not_finite(episode: Episode) -> str | None:
    """Find NaN and infinity."""
    for name, feature in FEATURES.items():
        value = getattr(episode, name)
        if value is not None and not np.isfinite(np.asarray(value, float)).all():
            return f"{feature.key} is not finite"
    return None


def out_of_limits(episode: Episode) -> str | None:
    """Find positions and angles that the hand cannot take."""
    low, high = _palm_range(episode)
    least, most = JOINT_RANGE_RAD
    for name in ("state", "action", "given_action", "executed_action"):
        if name == "action" and episode.meta.control_mode != JOINTS:  # a displacement, no place
            continue
        values = getattr(episode, name)
        palm = values[:, :PALM_DOF]
        joints = values[:, PALM_DOF:]
        beyond = np.maximum(low - palm, palm - high)  # (T, 3), positive outside
        frame, axis = np.unravel_index(int(beyond.argmax()), beyond.shape)
        if beyond[frame, axis] > PALM_SLACK_M:
            allowed = f"{low[axis]:.2f} to {high[axis]:.2f} m are possible"
            return (
                f"{name} has the palm at {palm[frame, axis]:.2f} m along axis {axis} at frame "
                f"{frame}; {allowed}"
            )
        if joints.min() < least or joints.max() > most:
            found = f"{float(joints.min()):.2f} to {float(joints.max()):.2f} rad"
            return f"{name} has joint angles from {found}; {least} to {most} rad are possible"
    return None


def jumps(episode: Episode) -> str | None:
    """Find steps of the hand that its servos cannot make within a frame."""
    # imports MuJoCo, which reading a dataset does not need
    from dynahoi_lerobot.captures import CAPTURES

    control = CONTROL_CLASSES[episode.meta.control_class]
    palm_speed_m_s = CAPTURES[episode.meta.capture].palm_speed_m_s(control)
    groups = (
        (slice(0, PALM_DOF), CATCH_UP * palm_speed_m_s * CONTROL_DT, "m"),
        (slice(PALM_DOF, HAND_DOF), OVERSHOOT * control.joint_speed_rad_s * CONTROL_DT, "rad"),
    )
    for name in ("state", "given_action", "executed_action"):
        values = getattr(episode, name)
        for part, allowed, unit in groups:
            steps = np.abs(np.diff(values[:, part], axis=0)).max(axis=1, initial=0.0)  # (T - 1,)
            worst = float(steps.max(initial=0.0))
            if worst > allowed:
                frame = int(steps.argmax()) + 1
                return (
                    f"{name} jumps by {worst:.2f} {unit} at frame {frame}; {allowed:.2f} "
                    f"{unit} is possible"
                )
    return None


def teleports(episode: Episode) -> str | None:
    """Find steps of the target that neither its own velocity nor a palm that carries it
    explains.
    """
    steps = np.linalg.norm(np.diff(episode.target_pose_h[:, :3], axis=0), axis=1)  # (T - 1,)
    carried = np.linalg.norm(np.diff(episode.palm_pos_h, axis=0), axis=1)
    speed = np.linalg.norm(episode.target_velocity_w[:, :3], axis=1)  # (T,)
    allowed = np.maximum(np.maximum(speed[1:], speed[:-1]) * CONTROL_DT, carried) + TARGET_SLACK_M
    if not (steps > allowed).any():
        return None
    frame = int((steps - allowed).argmax())
    possible = f"with its velocity {allowed[frame]:.2f} m is possible"
    return f"target_pose jumps by {steps[frame]:.2f} m at frame {frame + 1}; {possible}"


def saturation(episode: Episode) -> str | None:
    """Find catches whose labels have the palm at a limit of its slides; what was missed may well
    lie beyond it.
    """
    palm = episode.action[is_acting(episode.phase), :PALM_DOF]
    if not episode.success or not len(palm) or episode.action.shape[1] != HAND_DOF:
        return None
    low, high = _palm_range(episode)
    share = ((palm < low + 1e-3) | (palm > high - 1e-3)).mean(axis=0)  # (3,)
    if share.max() > PALM_SATURATED_SHARE:
        return (
            f"action[{int(share.argmax())}] is at its limit in {share.max():.0%} of the "
            f"control phase"
        )
    return None


def frozen(episode: Episode) -> str | None:
    """Find a measured state that stays the same to the last bit while it is commanded elsewhere."""
    state = episode.state
    command = episode.executed_action
    still = (state[1:] == state[:-1]).all(axis=1)  # (T - 1,)
    away = (
        np.abs(command[:-1, :PALM_DOF] - state[:-1, :PALM_DOF]).max(axis=1, initial=0.0)
        > FROZEN_GAP_M
    )
    begins = [start for start, end in runs(still & away) if end - start > FROZEN_FRAMES]
    return (
        f"state is frozen from frame {begins[0]} on while the hand is commanded to move"
        if begins
        else None
    )


def phase_order(episode: Episode) -> str | None:
    """Find phases that are not one-hot, and episodes that observe again after they began to act."""
    wrong = (episode.phase != one_hot_phase(np.maximum.accumulate(is_acting(episode.phase)))).any(
        axis=1
    )
    if not wrong.any():
        return None
    frame = int(wrong.argmax())
    return (
        f"phase is not [1, 0] and then [0, 1]: it is {episode.phase[frame].tolist()} at frame "
        f"{frame}"
    )


def _palm_range(episode: Episode) -> np.ndarray:
    """(2, 3) least and greatest palm position [m], home frame: the range of the slides."""
    return np.array(GANTRY_RANGE_M).T - episode.home_pos_w.astype(float)
