"""Success, stage and captured frames are the capture rule's own verdict on the stored columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.captures import CAPTURES, Track
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.foundation.conventions import PALM_DOF
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("verdict")
class Verdict(Check):
    """Asks the rule again; what touched the target besides fingers is not stored, and taken from ``captured``."""

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield verdicts that differ."""
        where = f"episode {row['episode_index']}"
        rule, track = CAPTURES[row["capture"]](), _track(row, columns)
        captured = np.zeros(len(columns["index"]), bool)
        captured[row["window_frames"] :] = rule.captured(track)
        wrong = np.flatnonzero(columns["captured"][:, 0].astype(bool) != captured)
        if wrong.size:
            frame = int(wrong[0])
            found = bool(columns["captured"][frame, 0])
            yield f"{where}, frame {frame}: captured is {found}; rule {rule.name!r} says {bool(captured[frame])}"
        for name, wanted in (("success", rule.success(track)), ("stage", rule.stage(track))):
            if row[name] != wanted:
                yield f"{where}: {name} is {row[name]!r}; rule {rule.name!r} says {wanted!r}"


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
