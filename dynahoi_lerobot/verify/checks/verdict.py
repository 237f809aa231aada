"""Success, stage, captured frames and ``next.*`` are the capture rule's own verdict on the stored columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.captures import CAPTURES, CaptureRule, Track
from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.rollout.recorder import next_frames
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns

PALM_ONLY = ("touched", "missed")
"""Stage of a failure in which only the palm touched the target, stored and as the stored columns tell it: that the palm
did is not among them, and only a replay can say."""


@CHECKS.register("verdict")
class Verdict(Check):
    """Asks the rule again; what touched the target besides fingers is not stored, and taken from ``captured``."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield verdicts that differ."""
        where = f"episode {row['episode_index']}"
        rule, track = CAPTURES[row["capture"]](), _track(row, columns)
        for key, wanted in _by_frame(rule, track, row["window_frames"]).items():
            wrong = np.flatnonzero(columns[key][:, 0] != wanted)
            if wrong.size:
                frame = int(wrong[0])
                found, said = columns[key][frame, 0].item(), wanted[frame].item()
                yield f"{where}, frame {frame}: {key} is {found}; rule {rule.name!r} says {said}"
        for name, wanted in (("success", rule.success(track)), ("stage", rule.stage(track))):
            if row[name] != wanted and (row[name], wanted) != PALM_ONLY:
                yield f"{where}: {name} is {row[name]!r}; rule {rule.name!r} says {wanted!r}"


def _by_frame(rule: CaptureRule, track: Track, window: int) -> dict[str, np.ndarray]:
    """Return by column what the rule says of each of T frames, (T,) each."""
    before = np.zeros(window, bool)
    captured = np.concatenate([before, rule.captured(track)])
    succeeded = next_frames(np.concatenate([before, rule.succeeded(track)]))
    return {
        "captured": captured,
        "next.success": succeeded,
        "next.reward": np.diff(succeeded, prepend=False).astype(np.float32),
        "next.done": np.arange(len(captured)) == len(captured) - 1,
    }


def _track(row: EpisodeRow, columns: Columns) -> Track:
    control = slice(row["window_frames"], None)
    state, captured = columns["observation.state"][control], columns["captured"][control, 0].astype(bool)
    touch = columns.get("observation.touch", columns["target.contacts"])[control]
    return Track(
        joints=state[:, PALM_DOF:],
        open_joints=np.asarray(row["stats/open_joints"], np.float32),
        reference_joints=np.asarray(row["stats/reference_joints"], np.float32),
        localized=columns["localized"][control, 0].astype(bool),
        contacts=TargetContacts(touch, captured.astype(float), (~captured).astype(float)),
        palm_distance=np.asarray(row["stats/palm_distance"])[control],
        palm_pos_h=state[:, :PALM_DOF],
    )
