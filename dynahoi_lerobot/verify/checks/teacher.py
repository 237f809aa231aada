"""What a teacher says in on-policy recordings follows from the target's path and from where the hand was."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, FINGER_DOF, PALM_DOF
from dynahoi_lerobot.core.rules import ControlClass, control_class_of, is_acting
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.quality_control import EXECUTED
from dynahoi_lerobot.experts.intercept import SPEED_M_S
from dynahoi_lerobot.motions import PrescribedMotion
from dynahoi_lerobot.rollout.teacher_labels import Lead
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns
from dynahoi_lerobot.verify.hand_kinematics import hand_kinematics
from dynahoi_lerobot.verify.stored_motion import stored_motion

TOLERANCE_M = 1e-4
"""Of points and distances computed from numbers in float32."""
EXPERT = "intercept"
"""The teacher whose labels are computed here."""


@CHECKS.register("teacher")
class TeacherCheck(Check):
    """Asks whether the label leads to where the teacher says it arrives, and whether it could not be there earlier.

    So much can be said of prescribed paths, where the target is not held and nothing is disturbed; a replay says all.
    """

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield interventions that the recipe does not give, and labels that the path contradicts."""
        recipe, where = dataset.recipe, f"episode {row['episode_index']}"
        if EXECUTED not in columns or recipe is None:
            return
        led = Lead.drawn(row["seed"], recipe.teacher_share).led
        wrong = np.flatnonzero(columns["intervention"][:, 0] != led)
        if wrong.size:
            yield f"{where}, frame {wrong[0]}: intervention is {not led}; seed and teacher_share give {led}"
        arrival = columns["teacher.arrival"][:, 0] / CONTROL_DT
        if (odd := np.flatnonzero(np.abs(arrival - arrival.round()) > 1e-3)).size:
            yield f"{where}, frame {odd[0]}: teacher.arrival is no whole number of frames of {CONTROL_DT} s"
        motion = stored_motion(row["motion"], row["parameters"])
        if recipe.expert == EXPERT and not recipe.disturbance_m and isinstance(motion, PrescribedMotion):
            yield from (f"{where}, frame {problem}" for problem in _labels(recipe, motion, row, columns))


def _labels(recipe: Recipe, motion: PrescribedMotion, row: EpisodeRow, columns: Columns) -> Iterator[str]:
    """Yield the first label that does not lead to its arrival, and the first arrival that could be earlier."""
    control = control_class_of(recipe.control_class)
    hand, origin = hand_kinematics(recipe.hand), np.concatenate([row["stats/home_position"], np.zeros(FINGER_DOF)])
    told = np.flatnonzero(is_acting(columns["observation.phase"]) & ~columns["localized"][:, 0].astype(bool))
    last = row["window_frames"] + row["length_frames"] - 1  # the teacher knows no path beyond the frame after it
    for frame in told[told > 0]:
        due = max(int(frame) + control.latency_frames, row["window_frames"])
        if due > last:
            return
        arrival = round(float(columns["teacher.arrival"][frame, 0]) / CONTROL_DT) - (due - int(frame))
        if arrival < 1:
            yield f"{frame}: teacher.arrival is before the command takes effect"
            return
        times = np.arange(due, due + arrival + 1) * CONTROL_DT
        path = motion.position(times) - origin[:PALM_DOF]
        state = columns[EXECUTED][frame - 1].astype(float)  # where the hand will be when the command takes effect
        closed = np.asarray(row["stats/reference_joints"], float)
        if (earlier := _earlier(path, state, closed, control)) is not None:
            yield f"{frame}: the teacher could arrive {arrival - earlier} frames before teacher.arrival"
            return
        wanted = np.clip(
            _towards(path, state[:PALM_DOF], control), *((hand.low - origin)[:3], (hand.high - origin)[:3])
        )
        apart = float(np.abs(columns["action"][frame, :PALM_DOF] - wanted).max())
        if apart > TOLERANCE_M:
            yield f"{frame}: action is {apart:.4f} m from the teacher's way to where the target is at teacher.arrival"
            return


def _step_m(control: ControlClass) -> float:
    """Return how far the teacher's palm goes in a frame [m]."""
    return min(SPEED_M_S, control.palm_speed_m_s) * CONTROL_DT


def _earlier(path: np.ndarray, state: np.ndarray, closed: np.ndarray, control: ControlClass) -> int | None:
    """Return the first frame before the last at which a hand (18,) can be on the path (K, 3) and closed, if any."""
    frames = np.arange(1, len(path) - 1)
    distance = np.linalg.norm(path[1:-1] - state[:PALM_DOF], axis=1)
    turned = frames * control.joint_speed_rad_s * CONTROL_DT >= np.abs(closed - state[PALM_DOF:]).max() + TOLERANCE_M
    possible = np.flatnonzero((distance < _step_m(control) * frames - TOLERANCE_M) & turned)
    return int(frames[possible[0]]) if possible.size else None


def _towards(path: np.ndarray, palm: np.ndarray, control: ControlClass) -> np.ndarray:
    """Return (3,) where a palm that goes straight to the end of the path (K, 3) in time is after a frame [m]."""
    way = path[-1] - palm
    return palm + way * min(1 / (len(path) - 1), _step_m(control) / max(float(np.linalg.norm(way)), 1e-12))
