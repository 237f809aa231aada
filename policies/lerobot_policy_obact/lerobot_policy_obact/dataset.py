"""What a dataset of DynaHOI says beside its frames: of the robot, of the rules, and of where the
targets are.

The last is read for training alone and never becomes an observation. Datasets from elsewhere say
nothing of it, and only their actions are learned.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor

from .configuration_obact import CONTACT, Embodiment
from .teacher import LONGEST_FRAMES, Targets, Teacher

# columns of a DynaHOI dataset, see its feature table
CAMERA_POSE, CAMERA_INTRINSICS, HAND_LIMITS = (
    "stats/{}_camera",
    "stats/{}_intrinsics",
    "stats/hand_limits",
)
TARGET_PATH, LOCALIZED = "stats/target_path", "stats/localized"
OPEN_JOINTS, CLOSED_JOINTS = "stats/open_joints", "stats/reference_joints"
CAPTURE, WINDOW = "capture", "window_frames"
RADIUS_M = {"attach": 0.03, "attach_lenient": 0.1}
"""Within which a palm has the target, by the rule of capture."""
CARRIED_VIEW = "ego"  # the view of the camera that the palm carries
CLOSED_QUANTILE = 0.6
"""Objects differ by 6 % in how far a hand closes around them; closing a little too far grasps more
of them."""


def episode_columns(meta: Any, wanted: Iterable[str]) -> dict[str, list[Any]]:
    """Return those of the ``wanted`` columns that the dataset has, an item an episode, in the order
    of episodes.

    LeRobot's own table of episodes leaves out the columns ``stats/``.
    """
    folder = meta.root / "meta/episodes"
    names = sorted({*wanted}.intersection(pq.ParquetDataset(folder).schema.names))
    table = pq.read_table(folder, columns=["episode_index", *names]).sort_by("episode_index")
    return {name: table[name].to_pylist() for name in names}


def rules_of(meta: Any) -> dict[str, Any]:
    """Return how the episodes of a dataset were played, as its manifest says; nothing if it has
    none.
    """
    manifest = meta.root / "meta" / "manifest.json"
    told = json.loads(manifest.read_text()) if manifest.exists() else {}
    for key in ("provenance", "recording", "recipe", "rules"):
        told = told.get(key) or {}
    return told


def embodiment_of(meta: Any, cameras: list[str]) -> Embodiment:
    """Return what a dataset says of its clock, its cameras, its hand and its targets.

    Episodes merged from elsewhere may lack these columns. Camera poses and hand limits then come
    from the first episode that has them; the target's path counts only if every episode has one.
    """
    views, calibration = {key: key.split(".")[-1] for key in cameras}, {}
    of_cameras = [
        name.format(view) for view in views.values() for name in (CAMERA_POSE, CAMERA_INTRINSICS)
    ]
    table = episode_columns(meta, [*of_cameras, HAND_LIMITS, CAPTURE, LOCALIZED])
    for key, view in views.items():
        pose = _first(table, CAMERA_POSE.format(view))
        if pose is not None:
            focal_px, _, centre_px, _ = _first(table, CAMERA_INTRINSICS.format(view))
            calibration[key] = [*pose, centre_px / focal_px, float(view == CARRIED_VIEW)]
    speed, _, latency_ms = _first(table, HAND_LIMITS) or (0.0, 0.0, 0.0)
    # with the palm's displacement as action (control mode grasp), the teachers' answers would be of
    # another kind
    absolute = meta.features[ACTION]["shape"] == meta.features.get(OBS_STATE, {}).get("shape")
    captures: list[Any] = table[CAPTURE] if LOCALIZED in table and absolute else [None]
    lacking = captures.count(None)
    if 0 < lacking < len(captures):
        logging.warning(
            "%d of %d episodes lack the target's path: only actions are learned",
            lacking,
            len(captures),
        )
    capture = "" if lacking else captures[0]
    if capture == CONTACT:
        logging.warning("targets must be gripped: only actions are learned")
        capture = ""
    return Embodiment(
        fps=float(meta.fps),
        calibration=calibration,
        delay_frames=math.ceil(latency_ms / 1000 * meta.fps - 1e-6),
        palm_speed_m_s=float(speed),
        capture=capture,
        radius_m=RADIUS_M.get(capture, Embodiment.radius_m),
    )


def _first(table: dict[str, list[Any]], name: str) -> Any:
    """Return the first value of a column that is not null; None if there is none."""
    return next((value for value in table.get(name, []) if value is not None), None)


@dataclass(frozen=True)
class TargetTable:
    """Where the targets of E episodes are, and what should be done about them."""

    path: Tensor  # of the untouched target [m], (E, F, 3)
    length: Tensor  # known frames of that, (E,)
    free: Tensor  # the frame in which the recorded hand has caught it, (E,)
    begin: Tensor  # the frame in which the hand may move, (E,)
    first_index: Tensor  # of the dataset, of the frames of an episode, (E,)
    teacher: Teacher

    @classmethod
    def of(cls, meta: Any, embodiment: Embodiment) -> TargetTable:
        """Return that of the dataset of LeRobot's metadata, which has the target's path."""
        wanted = ("length", WINDOW, TARGET_PATH, LOCALIZED, OPEN_JOINTS, CLOSED_JOINTS)
        table = episode_columns(meta, wanted)
        paths = [torch.tensor(np.array(x, np.float32)).reshape(-1, 3) for x in table[TARGET_PATH]]
        free = [flags.index(True) if True in flags else len(flags) for flags in table[LOCALIZED]]
        open_joints, closed_joints = (
            torch.tensor(np.stack(table[name]), dtype=torch.float32).quantile(
                CLOSED_QUANTILE, dim=0
            )
            for name in (OPEN_JOINTS, CLOSED_JOINTS)
        )
        hand = embodiment.fps, embodiment.step_m, open_joints, closed_joints
        count = torch.tensor(table["length"])
        return cls(
            torch.nn.utils.rnn.pad_sequence(paths, batch_first=True),
            torch.tensor([len(path) for path in paths]),
            torch.tensor(free),
            torch.tensor([frames or 0 for frames in table[WINDOW]], dtype=torch.long),
            count.cumsum(0) - count,
            Teacher(*hand, radius_m=embodiment.radius_m),
        )

    def window(self, episode: Tensor, first: Tensor, n_frames: int) -> tuple[Targets, Tensor]:
        """Return targets from the ``first`` frames ``(B,)`` of episodes ``(B,)`` on, and the frames
        in which the hands may move, both counted from there.

        Their paths go on beyond the ``n_frames`` of a window, as far as a teacher looks. A target
        waits before its recording, and where its path is no longer known.
        """
        length = self.length[episode]
        frame = first[:, None] + torch.arange(n_frames + LONGEST_FRAMES)
        inside = torch.minimum(frame.clamp_min(0), length[:, None] - 1)
        path, free = self.path[episode[:, None], inside], self.free[episode]
        targets = Targets(path, length - first, free - first)
        return targets, self.begin[episode] - first
