"""A whole dataset as tables, to learn from; training only.

LeRobot hands out frames with their images, which takes longer to read than to learn from. A frozen encoder says the
same of an image whenever it is asked, so all images are encoded before training begins (`encoded_images`) and kept in
memory; a batch then only says which episodes there are. What a dataset of DynaHOI knows of its targets (the ``stats/``
columns of the episode table) is read at the same time and never becomes an observation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from lerobot.utils.constants import ACTION
from torch import Tensor

from .configuration_obact import CONTACT, ObActConfig, Rig
from .decisions import Episodes
from .encoded_images import encoded_images
from .teacher import Grip, Meet, Targets, Teacher

if TYPE_CHECKING:
    from .modeling_obact import ObActModel

CAMERA_POSE, CAMERA_INTRINSICS, HAND_LIMITS = "stats/{}_camera", "stats/{}_intrinsics", "stats/hand_limits"
TARGET_PATH, TARGET_POSE, LOCALIZED = "stats/target_path", "stats/target.pose", "stats/localized"
OPEN_JOINTS, CLOSED_JOINTS = "stats/open_joints", "stats/reference_joints"
CAPTURE, WINDOW = "capture", "window_frames"
"""Columns of the episode table of a DynaHOI dataset, see its feature table."""
RADIUS_M = {"attach": 0.03, "attach_lenient": 0.1}
"""Within which a palm has the target, by the rule of capture; under others it must be gripped."""
GRIP_M = 0.015
"""Within which of its seat a target that moves along with the hand is gripped."""
CARRIED_VIEW = "ego"
"""The view of the camera that the palm carries."""
CLOSED_QUANTILE = 0.6
"""Objects differ by 6 % in how far a hand closes around them; closing a little too far grasps more of them."""
NEVER = 1 << 20
"""The frame of what does not happen."""


@dataclass
class Recordings:
    """N frames of E episodes.

    Attributes:
        sightings: of all frames, ``(N, C, 5 + E')``.
        state: ``(N, S)``.
        actions: ``(N, A)``.
        first, count: first frame and number of frames of each episode, ``(E,)``.
        window: frames of its observation window, ``(E,)``; 0 if there is none.
        named: episodes that a batch of the training has named, bool, ``(E,)``; nothing is learned from others.
        fps: frame rate [Hz].
        targets: what is known of the targets; None if the dataset does not say.
        teacher: what to do about those.
        places: where the targets were in all frames [m], ``(N, 3)``.
    """

    sightings: Tensor
    state: Tensor
    actions: Tensor
    first: Tensor
    count: Tensor
    window: Tensor
    named: Tensor
    fps: float
    targets: Targets | None = None
    teacher: Teacher | None = None
    places: Tensor | None = None

    def episodes(self, chosen: Tensor) -> Episodes:
        """Return episodes ``(B,)`` as they were recorded."""
        count = self.count[chosen]
        ahead = torch.arange(int(count.max()))
        index = self.first[chosen, None] + torch.minimum(ahead, count[:, None] - 1)
        targets = None if self.targets is None else self.targets.of(chosen)
        sightings, state, actions = (x[index] for x in (self.sightings, self.state, self.actions))
        return Episodes(sightings, state, actions, count, self.window[chosen], self.fps, targets)

    def draw(self, n: int) -> Tensor:
        """Draw n episodes of similar length that may be learned from."""
        known = self.named.nonzero()[:, 0]
        return similar(known[torch.randint(len(known), (SPREAD * n,))], self.count, n)

    @classmethod
    def encoded(cls, meta: Any, config: ObActConfig, model: ObActModel) -> Recordings:
        """Return a dataset with all its images encoded.

        Args:
            meta: LeRobot's metadata of a dataset on this disk.
            config: of the policy.
            model: whose encoders are used.
        """
        known = {TARGET_PATH, LOCALIZED, OPEN_JOINTS, CLOSED_JOINTS, TARGET_POSE} if config.forecasts else set()
        table = episode_columns(meta, {"length", WINDOW} | known)
        columns = _frame_columns(meta, [*config.state_keys, ACTION])
        count = torch.tensor(table["length"])
        recordings = cls(
            sightings=encoded_images(meta, config, model, table["length"]),
            state=torch.cat([columns[key] for key in config.state_keys], dim=-1),
            actions=columns[ACTION],
            first=count.cumsum(0) - count,
            count=count,
            window=torch.tensor(table.get(WINDOW, [0] * len(count))),
            named=torch.zeros(len(count), dtype=torch.bool),
            fps=config.rig.fps,
        )
        if config.forecasts:
            paths = [torch.tensor(np.array(path, np.float32)).reshape(-1, 3) for path in table[TARGET_PATH]]
            length, path = torch.tensor([len(path) for path in paths]), torch.nn.utils.rnn.pad_sequence(paths, True)
            free = torch.tensor([flags.index(True) if True in flags else len(flags) for flags in table[LOCALIZED]])
            recordings.targets = Targets(path, length, free, path, torch.full_like(length, NEVER))
            recordings.teacher = teacher_of(config.rig, table)
            poses = [np.array(poses, np.float32).reshape(-1, 7)[:, :3] for poses in table[TARGET_POSE]]
            recordings.places = torch.from_numpy(np.concatenate(poses))
        return recordings


SPREAD = 6
"""Of so many times more episodes than wanted, those of similar length are taken, which need little padding."""


def similar(candidates: Tensor, length: Tensor, n: int) -> Tensor:
    """Return n of several times n episodes, of similar ``length`` ``(E,)``, which is that of all episodes."""
    order = candidates[(length[candidates] + torch.rand(len(candidates))).argsort()]
    return order.view(-1, n)[torch.randint(len(order) // n, ())]


def teacher_of(rig: Rig, table: dict[str, list[Any]]) -> Teacher:
    """Return the teacher of a dataset with the episode table ``table``."""
    joints = (torch.tensor(np.stack(table[name]), dtype=torch.float32) for name in (OPEN_JOINTS, CLOSED_JOINTS))
    hand = (rig.fps, rig.step_m, *(angles.quantile(CLOSED_QUANTILE, dim=0) for angles in joints))
    return Grip(*hand, radius_m=GRIP_M) if rig.capture == CONTACT else Meet(*hand, radius_m=rig.radius_m)


def describe(meta: Any, cameras: list[str]) -> Rig:
    """Return what a dataset says of its clock, its cameras, its hand and its targets."""
    views, calibration = {key: key.split(".")[-1] for key in cameras}, {}
    of_cameras = {name.format(view) for view in views.values() for name in (CAMERA_POSE, CAMERA_INTRINSICS)}
    table = episode_columns(meta, of_cameras | {HAND_LIMITS, CAPTURE})
    for key, view in views.items():
        if pose := table.get(CAMERA_POSE.format(view)):
            focal_px, _, centre_px, _ = table[CAMERA_INTRINSICS.format(view)][0]
            calibration[key] = [*pose[0], centre_px / focal_px, float(view == CARRIED_VIEW)]
    speed, _, latency_ms = table[HAND_LIMITS][0] if HAND_LIMITS in table else (0.0, 0.0, 0.0)
    # with the palm's displacement as action (control mode grasp), the teachers' answers would be of another kind
    absolute = meta.features[ACTION]["shape"] == meta.features.get("observation.state", {}).get("shape")
    capture = table[CAPTURE][0] if TARGET_PATH in _schema(meta) and absolute else ""
    return Rig(
        fps=float(meta.fps),
        calibration=calibration,
        delay_frames=math.ceil(latency_ms / 1000 * meta.fps - 1e-6),
        palm_speed_m_s=float(speed),
        capture=capture,
        radius_m=RADIUS_M.get(capture, Rig.radius_m),
    )


# -- the files of a dataset -----------------------------------------------------------------------------------------


def episode_columns(meta: Any, wanted: set[str]) -> dict[str, list[Any]]:
    """Return those of the ``wanted`` columns of the episode table that the dataset has, in the order of episodes."""
    held = [name for name in _schema(meta) if name in wanted]
    table = _table(meta, "meta/episodes", "episode_index", held)
    return {name: table[name].to_pylist() for name in held}


def _frame_columns(meta: Any, keys: list[str]) -> dict[str, Tensor]:
    """Return columns of the frame table in the order of frames, ``(N, D)`` each."""
    table = _table(meta, "data", "index", keys)
    return {key: torch.from_numpy(np.array(table[key].to_pylist(), np.float32)).reshape(len(table), -1) for key in keys}


def _schema(meta: Any) -> list[str]:
    return pq.read_schema(next(Path(meta.root).glob("meta/episodes/*/*.parquet"))).names


def _table(meta: Any, folder: str, order: str, columns: list[str]) -> pa.Table:
    files = sorted(Path(meta.root).glob(f"{folder}/*/*.parquet"))
    return pa.concat_tables([pq.read_table(file, columns=[order, *columns]) for file in files]).sort_by(order)
