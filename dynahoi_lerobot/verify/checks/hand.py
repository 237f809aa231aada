"""Fingertips, commands and measured states are those of one hand and its servos."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.captures import CAPTURES, Weld
from dynahoi_lerobot.core.conventions import FINGER_DOF, PALM_DOF
from dynahoi_lerobot.core.rules import CONTROL_CLASSES
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.quality_control import executed_key
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns
from dynahoi_lerobot.verify.hand_kinematics import hand_kinematics

TIP_TOLERANCE = 2e-5
"""Of fingertips, which are computed from the stored joints in float32 [m, rad]."""
RANGE_TOLERANCE = 1e-5
"""Of commands at an end of their range, in float32 [m, rad]."""
PALM_LAG_M = 0.01
"""An undisturbed palm reaches its command within a frame (0.0033 m seen, where it carries a target)."""
JOINT_LAG_RAD = 0.03
"""So do fingers that touch nothing (0.010 rad seen, at the fastest closing of 20 rad/s)."""


@CHECKS.register("hand")
class HandCheck(Check):
    """Computes the fingertips again, and follows the commands; needs the recipe, which names the hand."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield states that no hand of this name has, or that its servos would not have reached."""
        if (recipe := dataset.recipe) is None:
            return
        problems = (
            _fingertips(recipe, columns),
            _range(recipe, row, "action", columns),
            _range(recipe, row, executed_key(columns), columns),
            _lag(recipe, columns),
            _open(recipe, row),
        )
        yield from (f"episode {row['episode_index']}{problem}" for problem in dict.fromkeys(problems) if problem)


def _fingertips(recipe: Recipe, columns: Columns) -> str | None:
    apart = np.abs(
        hand_kinematics(recipe.hand).fingertips(columns["observation.state"]) - columns["observation.fingertips"]
    )
    apart = np.minimum(apart, np.abs(apart - 2 * np.pi)).max(axis=1)  # a rotation vector of half a turn has two signs
    if apart.max() <= TIP_TOLERANCE:
        return None
    frame = int(apart.argmax())
    return f", frame {frame}: observation.fingertips is {apart[frame]:.2g} m or rad off the kinematics of its state"


def _range(recipe: Recipe, row: EpisodeRow, key: str, columns: Columns) -> str | None:
    hand, action = hand_kinematics(recipe.hand), columns[key]
    origin = np.concatenate([row["stats/home_position"], np.zeros(FINGER_DOF)])
    low, high = hand.low - origin, hand.high - origin
    beyond = np.maximum(low - action, action - high)  # (T, 18), positive outside
    frame, axis = np.unravel_index(int(beyond.argmax()), beyond.shape)
    if beyond[frame, axis] <= RANGE_TOLERANCE:
        return None
    allowed = f"commands are clipped to {low[axis]:.2f} to {high[axis]:.2f}"
    return f", frame {frame}: {key}[{axis}] is {action[frame, axis]:.3f}; {allowed}"


def _lag(recipe: Recipe, columns: Columns) -> str | None:
    """Find a state that is not where its command led; contact holds fingers back, a disturbance the palm."""
    if recipe.disturbance_m:
        return None
    frames = 1 + CONTROL_CLASSES[recipe.control_class].latency_frames  # until a command has been followed
    key = executed_key(columns)
    apart = np.abs(columns["observation.state"][frames:] - columns[key][:-frames])  # (T - frames, 18)
    groups = [("palm", apart[:, :PALM_DOF], PALM_LAG_M, "m")]
    if isinstance(CAPTURES[recipe.capture].effect, Weld):
        groups.append(("a joint", apart[:, PALM_DOF:], JOINT_LAG_RAD, "rad"))
    for name, gap, tolerance, unit in groups:
        if gap.size and gap.max() > tolerance:
            frame = int(gap.max(axis=1).argmax()) + frames
            return f", frame {frame}: observation.state has {name} {gap.max():.3f} {unit} from where {key} led"
    return None


def _open(recipe: Recipe, row: EpisodeRow) -> str | None:
    wanted, found = HANDS[recipe.hand]().open_joints(), np.asarray(row["stats/open_joints"], float)
    if found.shape == wanted.shape and np.abs(found - wanted).max() <= RANGE_TOLERANCE:
        return None
    return f": open_joints is not the open hand {recipe.hand!r}"
