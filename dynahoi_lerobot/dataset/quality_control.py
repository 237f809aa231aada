"""Quality control: rules that reject corrupt trajectories (Appendix "Post-processing and quality control").

Each rule looks at one episode's columns and returns a sentence about what is wrong, or None. Generation draws a
rejected episode again; ``dynahoi verify`` applies the same rules to what is stored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.foundation.conventions import CONTROL_DT, PALM_DOF

Columns = Mapping[str, np.ndarray]
"""An episode's numeric columns by key, each (T, D)."""


@dataclass(frozen=True)
class TrajectoryLimits:
    """Bounds that no intact recording exceeds; wider than those of any hand, so that only corruption is rejected.

    Attributes:
        palm_m: largest distance of the palm from the origin along an axis [m].
        joint_low_rad: least joint angle [rad].
        joint_high_rad: greatest joint angle [rad].
        palm_speed_m_s: greatest speed of the palm between two frames [m/s].
        joint_speed_rad_s: greatest speed of a joint between two frames [rad/s].
        object_speed_m_s: greatest speed of the target between two frames [m/s].
        saturated_share: share of the control phase that a command may stay at a limit.
    """

    palm_m: float = 5.0
    joint_low_rad: float = -1.0
    joint_high_rad: float = 2.5
    palm_speed_m_s: float = 6.0
    joint_speed_rad_s: float = 40.0
    object_speed_m_s: float = 25.0
    saturated_share: float = 0.9


Rule = Callable[[Columns, TrajectoryLimits], str | None]


def trajectory_problems(columns: Columns, limits: TrajectoryLimits | None = None) -> list[str]:
    """Return a sentence for each rule that the episode breaks; only the first if it holds NaN or infinity."""
    problems = not_finite(columns)
    if problems:
        return [problems]
    found = (rule(columns, limits or TrajectoryLimits()) for rule in (out_of_limits, jumps, saturation, phase_order))
    return [problem for problem in found if problem]


def not_finite(columns: Columns) -> str | None:
    """Find NaN and infinity."""
    for key, values in columns.items():
        bad = ~np.isfinite(values.astype(float)).reshape(len(values), -1).all(axis=1)
        if bad.any():
            return f"{key} is not finite at frame {int(np.argmax(bad))}"
    return None


def out_of_limits(columns: Columns, limits: TrajectoryLimits) -> str | None:
    """Find positions and angles that the hand cannot take."""
    for key in ("observation.state", "action"):
        palm, joints = columns[key][:, :PALM_DOF], columns[key][:, PALM_DOF:]
        if (worst := float(np.abs(palm).max())) > limits.palm_m:
            return f"{key} has the palm at {worst:.2f} m from the origin; {limits.palm_m} m is the limit"
        low, high = float(joints.min()), float(joints.max())
        if low < limits.joint_low_rad or high > limits.joint_high_rad:
            allowed = f"{limits.joint_low_rad} to {limits.joint_high_rad} rad"
            return f"{key} has joint angles from {low:.2f} to {high:.2f} rad; {allowed} are possible"
    return None


def jumps(columns: Columns, limits: TrajectoryLimits) -> str | None:
    """Find steps between frames that are too large for the control rate."""
    groups = (
        ("observation.state", slice(0, PALM_DOF), limits.palm_speed_m_s, "m"),
        ("observation.state", slice(PALM_DOF, None), limits.joint_speed_rad_s, "rad"),
        ("target.pose", slice(0, 3), limits.object_speed_m_s, "m"),
    )
    for key, part, speed, unit in groups:
        steps = np.abs(np.diff(columns[key][:, part], axis=0)).max(axis=1, initial=0.0)  # (T - 1,)
        if steps.size and (worst := float(steps.max())) > speed * CONTROL_DT:
            frame = int(np.argmax(steps)) + 1
            return f"{key} jumps by {worst:.2f} {unit} at frame {frame}; {speed * CONTROL_DT:.2f} {unit} is possible"
    return None


def saturation(columns: Columns, limits: TrajectoryLimits) -> str | None:
    """Find commands that stay at a limit of the hand through the control phase."""
    acting = columns["observation.phase"][:, 0] > 0.5
    commands = columns["action"][acting]
    if not len(commands):
        return None
    at_limit = np.zeros(commands.shape, bool)
    at_limit[:, :PALM_DOF] = np.abs(commands[:, :PALM_DOF]) > limits.palm_m - 1e-3
    at_limit[:, PALM_DOF:] = commands[:, PALM_DOF:] > limits.joint_high_rad - 1e-3
    share = at_limit.mean(axis=0)
    if share.max() > limits.saturated_share:
        return f"action[{int(share.argmax())}] is at its limit in {share.max():.0%} of the control phase"
    return None


def phase_order(columns: Columns, limits: TrajectoryLimits) -> str | None:
    """Find episodes that observe again after they began to act."""
    phase = columns["observation.phase"][:, 0]
    if not np.isin(phase, (0, 1)).all() or (np.diff(phase) < 0).any():
        return "observation.phase is not a window of 0 followed by 1"
    return None
