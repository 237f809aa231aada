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

from .configuration_obact import CONTACT, IMAGES, SIGHTINGS, Embodiment
from .teacher import LONGEST_FRAMES, Targets, Teacher

# the tables of a DynaHOI dataset with a row per episode, per frame, and per episode again, and
# their columns, see its card
EPISODES, CAPTURE, WINDOW = "meta/episodes", "capture", "window_frames"
TRUTH, LOCALIZED = "meta/privileged", "localized"
CONSTANTS, TARGET_PATH, HAND_LIMITS = "meta/privileged_episodes", "target_path", "hand_limits"
OPEN_JOINTS, CLOSED_JOINTS = "open_joints", "reference_joints"
CAMERA_POSE, CAMERA_INTRINSICS = "{}_camera", "{}_intrinsics"
SCHEMA = 1
"""Of the datasets of DynaHOI that are read here."""
RADIUS_M = {"attach": 0.03, "attach_lenient": 0.1}
"""Within which a palm has the target, by the rule of capture."""
CARRIED_VIEW = "ego"  # the view of the camera that the palm carries
CLOSED_QUANTILE = 0.6
"""Objects differ by 6 % in how far a hand closes around them; closing a little too far grasps more
of them."""


def columns_of(meta: Any, folder: str, wanted: Iterable[str]) -> dict[str, list[Any]]:
    """Return those of the ``wanted`` columns that the table in a folder's files has, in the order
    of episodes and their frames; nothing if the dataset has no such table.
    """
    if not (meta.root / folder).is_dir():
        return {}
    held = pq.ParquetDataset(meta.root / folder).schema.names
    order = [key for key in ("episode_index", "frame_index") if key in held]
    names = sorted({*wanted, *order} & {*held})
    table = pq.read_table(meta.root / folder, columns=names)
    table = table.sort_by([(key, "ascending") for key in order])
    return {name: table[name].to_pylist() for name in names}


def rules_of(meta: Any) -> dict[str, Any]:
    """Return how the episodes of a dataset were played, as its manifest says; nothing if it has
    none.

    Raises:
        ValueError: if the manifest is of another schema than the one that is read here.
    """
    manifest = meta.root / "meta" / "manifest.json"
    if not manifest.exists():
        return {}
    told = json.loads(manifest.read_text())
    found = told.get("schema")
    if found != SCHEMA:
        raise ValueError(
            f"{manifest} has schema {found!r}, and this policy reads schema {SCHEMA}; generate the "
            "dataset again"
        )
    for key in ("provenance", "recording", "recipe", "rules"):
        told = told.get(key) or {}
    return told


def embodiment_of(meta: Any, cameras: list[str]) -> Embodiment:
    """Return what a dataset says of its clock, its cameras, its hand and its targets.

    Raises:
        ValueError: if the dataset knows the poses of its cameras, but has one of ``cameras`` under
            another name.
    """
    views = {key: key.split(".")[-1] for key in cameras}
    of_cameras = {
        name.format(view) for view in views.values() for name in (CAMERA_POSE, CAMERA_INTRINSICS)
    }
    constants = columns_of(meta, CONSTANTS, of_cameras | {HAND_LIMITS, TARGET_PATH})
    captures = columns_of(meta, EPISODES, {CAPTURE}).get(CAPTURE)
    if captures and not constants:
        logging.warning(
            "%s is gone, which LeRobot's tools drop when they edit a dataset: the closed loop is "
            "off, and only actions are learned",
            meta.root / CONSTANTS,
        )
    held = {name.replace(SIGHTINGS, IMAGES) for name in meta.features}
    for key in cameras if constants else ():
        if key not in held:
            raise ValueError(
                f"{meta.repo_id} has no {key}, under whose name ObAct looks up the camera's pose: "
                f"train without --rename_map, from random weights"
            )
    calibration = {}
    for key, view in views.items():
        if CAMERA_POSE.format(view) in constants:
            pose = constants[CAMERA_POSE.format(view)][0]
            focal_px, _, centre_px, _ = constants[CAMERA_INTRINSICS.format(view)][0]
            calibration[key] = [*pose, centre_px / focal_px, float(view == CARRIED_VIEW)]
    speed, _, latency_ms = constants.get(HAND_LIMITS, [(0.0, 0.0, 0.0)])[0]
    # with the palm's displacement as action (control mode grasp), the teachers' answers would be of
    # another kind
    absolute = meta.features[ACTION]["shape"] == meta.features.get(OBS_STATE, {}).get("shape")
    known = TARGET_PATH in constants and (meta.root / TRUTH).is_dir()
    capture = captures[0] or "" if captures and known and absolute else ""
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


@dataclass(frozen=True)
class TargetTable:
    """Where the targets of E episodes are, and what should be done about them."""

    path: Tensor  # of the untouched target [m], (E, F, 3)
    length: Tensor  # known frames of that, (E,)
    free: Tensor  # the frame in which the recorded hand has caught it, (E,)
    begin: Tensor  # the frame in which the hand may move, (E,)
    first_index: Tensor  # of the dataset, of the frames of an episode, (E,)
    # in the loss, of a window, (E,): less in episodes with more windows, so that all count alike
    weight: Tensor
    teacher: Teacher

    @classmethod
    def of(cls, meta: Any, embodiment: Embodiment) -> TargetTable:
        """Return that of the dataset of LeRobot's metadata, which has the target's path."""
        table = columns_of(meta, EPISODES, {"length", WINDOW})
        constants = columns_of(meta, CONSTANTS, {TARGET_PATH, OPEN_JOINTS, CLOSED_JOINTS})
        truth = columns_of(meta, TRUTH, {LOCALIZED})
        count = torch.tensor(table["length"])
        if not np.array_equal(np.bincount(truth["episode_index"]), count):
            raise ValueError(
                f"{meta.root / TRUTH} is of other episodes than {meta.root / EPISODES}: another "
                "tool has edited the dataset; `dynahoi verify` says what is left of it"
            )
        paths = [torch.tensor(np.array(path, np.float32)) for path in constants[TARGET_PATH]]
        flags = torch.tensor(truth[LOCALIZED]).split(count.tolist())
        free = torch.tensor([int((~held).cumprod(0).sum()) for held in flags])
        open_joints, closed_joints = (
            torch.tensor(constants[name], dtype=torch.float32).quantile(CLOSED_QUANTILE, dim=0)
            for name in (OPEN_JOINTS, CLOSED_JOINTS)
        )
        hand = embodiment.fps, embodiment.step_m, open_joints, closed_joints
        return cls(
            torch.nn.utils.rnn.pad_sequence(paths, batch_first=True),
            torch.tensor([len(path) for path in paths]),
            free,
            torch.tensor([frames or 0 for frames in table[WINDOW]], dtype=torch.long),
            count.cumsum(0) - count,
            free.float().mean() / free.clamp_min(1),
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
