"""What the episode table says about an episode is what its frames show."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.rules import CONTROL_CLASSES, is_acting
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.quality_control import EXECUTED
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


def observed(row: EpisodeRow) -> int:
    """Return for how many frames an episode observes: acting begins with the first command that is not void."""
    control = CONTROL_CLASSES.get(row["control_class"])
    return max(row["window_frames"] - (control.latency_frames if control else 0), 0)


@CHECKS.register("episode_columns")
class EpisodeColumns(Check):
    """Compares the per-episode columns with the frames."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield contradictions."""
        frames, window = len(columns["index"]), int((~is_acting(columns["observation.phase"])).sum())
        intercept = float(columns["intercept.time"][0, 0])
        facts = (
            ("{} frames observe by window_frames and control_class, {} by observation.phase", observed(row), window),
            ("palm_distance has {} values for {} frames", len(row["stats/palm_distance"]), frames),
            ("fingertip_distance has {} values for {} frames", len(row["stats/fingertip_distance"]), frames),
            ("attempt_success is {}, success and attempts give {}", row["stats/attempt_success"], _attempts(row)),
        )
        problems = [sentence.format(said, found) for sentence, said, found in facts if said != found]
        if frames != (wanted := _recorded(row, columns)):
            problems.append(
                f"length_frames is {row['length_frames']}, so {wanted} frames are recorded; there are {frames}"
            )
        if abs(row["intercept_frame"] * CONTROL_DT - intercept) > 1e-4:
            problems.append(f"intercept_frame is {row['intercept_frame']}, intercept.time is {intercept:.3f} s")
        keeps_failures = dataset.recipe.keeps_failures if dataset.recipe else EXECUTED in columns
        if not row["success"] and not keeps_failures:
            problems.append("success is False, only successes are stored")
        if row["attempts"] < 1:
            problems.append(f"attempts is {row['attempts']}, it is 1 or more")
        for key in ("intercept.position", "intercept.time"):
            if np.ptp(columns[key], axis=0).any():
                problems.append(f"{key} changes within the episode")
        problems += _parameters(row["parameters"])
        yield from (f"episode {row['episode_index']}: {problem}" for problem in problems)


def _recorded(row: EpisodeRow, columns: Columns) -> int:
    """For how many frames an episode is recorded: an on-policy one as an evaluation is, see ``Job.evaluation``."""
    length = row["length_frames"]
    if EXECUTED not in columns:
        return length
    localized, settled = columns["localized"][:, 0], CAPTURES[row["capture"]].settle_frames
    full = row["window_frames"] + length + 1
    return min(full, int(localized.argmax()) + settled + 1) if localized.any() else full


def _attempts(row: EpisodeRow) -> list[bool]:
    """Whether each attempt succeeded: an episode ends with its first success, or with its last attempt."""
    return [False] * (row["attempts"] - 1) + [row["success"]]


def _parameters(text: str) -> list[str]:
    try:
        return [] if isinstance(json.loads(text), dict) else [f"parameters is no JSON object: {text!r}"]
    except ValueError:
        return [f"parameters is no JSON: {text!r}"]
