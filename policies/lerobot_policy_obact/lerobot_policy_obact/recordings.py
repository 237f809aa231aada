"""A whole dataset as tables, to learn from; training only.

A frozen encoder says the same of an image whenever it is asked, so all images are encoded before
training begins, kept in memory, and on disk for the next run with the same images and weights; a
batch then only says which episodes there are. What a dataset of DynaHOI knows of its targets (its
privileged tables) is read at the same time and never becomes an observation.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.video_utils import decode_video_frames
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME
from safetensors.torch import load_file, save
from torch import Tensor
from tqdm import tqdm

from .configuration_obact import CONTACT, ObActConfig, Rig
from .decisions import SPREAD, Episodes
from .network import ObActModel
from .teacher import NEVER, Grip, Targets, Teacher

# the tables of a DynaHOI dataset with a row per episode, per frame, and per episode again, and
# their columns, see its card
EPISODES, CAPTURE, WINDOW = "meta/episodes", "capture", "window_frames"
TRUTH, TARGET_POSE, LOCALIZED = "meta/privileged", "target.pose", "localized"
CONSTANTS, TARGET_PATH, HAND_LIMITS = "meta/privileged_episodes", "target_path", "hand_limits"
OPEN_JOINTS, CLOSED_JOINTS = "open_joints", "reference_joints"
CAMERA_POSE, CAMERA_INTRINSICS = "{}_camera", "{}_intrinsics"
SCHEMA = 1
"""Of the datasets of DynaHOI that are read here."""
RADIUS_M = {"attach": 0.03, "attach_lenient": 0.1}
"""Within which a palm has the target, by the rule of capture; under others it must be gripped."""
GRIP_M = 0.015  # within which of its seat a target that moves along with the hand is gripped
CARRIED_VIEW = "ego"  # the view of the camera that the palm carries
CLOSED_QUANTILE = 0.6
"""Objects differ by 6 % in how far a hand closes around them; closing a little too far grasps more
of them."""
CACHE, SIGHTINGS = "obact_sightings", "sightings"
"""Folder of the cache of encoded images, beside LeRobot's datasets, and the name of the tensor in a
file of it."""
TAIL_BYTES = 65536  # of a file that tell it from others: a video's index, a table's footer


@dataclass
class Recordings:
    """All episodes of a dataset, E of at most T frames."""

    episodes: Episodes  # as they were recorded
    # those that a batch of the training has named, bool, (E,); nothing is learned from others
    named: Tensor
    teacher: Teacher | None = (
        None  # of what to do about the targets; None if the dataset does not say where they are
    )
    places: Tensor | None = None  # where those were [m], (E, T, 3)

    def draw(self, n: int) -> Episodes:
        """Draw n episodes of similar length that may be learned from."""
        known = self.named.nonzero()[:, 0]
        return self.episodes.similar(known[torch.randint(len(known), (SPREAD * n,))], n)

    @classmethod
    def encoded(cls, meta: Any, config: ObActConfig, model: ObActModel) -> Recordings:
        """Return the dataset of LeRobot's metadata, which is on this disk, with all images encoded
        by the model.
        """
        table = _table(meta, EPISODES, {"length", WINDOW})
        columns = {
            key: _tensor(column)
            for key, column in _table(meta, "data", {*config.state_keys, ACTION}).items()
        }
        count = torch.tensor(table["length"])
        index = (
            torch.minimum(torch.arange(int(count.max())), count[:, None] - 1)
            + (count.cumsum(0) - count)[:, None]
        )
        state = torch.cat([columns[key] for key in config.state_keys], dim=-1)
        window = torch.tensor(
            [frames or 0 for frames in table.get(WINDOW, [0] * len(count))], dtype=torch.long
        )
        sightings = encoded_images(meta, config, model, table["length"])
        episodes = Episodes(sightings[index], state[index], columns[ACTION][index], count, window)
        named = torch.zeros(len(count), dtype=torch.bool)
        if not config.forecasts:
            return cls(episodes, named)
        truth = _table(meta, TRUTH, {TARGET_POSE, LOCALIZED, "episode_index"})
        if not np.array_equal(np.bincount(truth["episode_index"]), count):
            raise ValueError(
                f"{meta.root / TRUTH} is of other episodes than {meta.root / EPISODES}: another "
                "tool has edited the dataset; `dynahoi verify` says what is left of it"
            )
        constants = _table(meta, CONSTANTS, {TARGET_PATH, OPEN_JOINTS, CLOSED_JOINTS})
        paths = [_tensor(path) for path in constants[TARGET_PATH]]
        length, path = (
            torch.tensor([len(path) for path in paths]),
            torch.nn.utils.rnn.pad_sequence(paths, True),
        )
        flags = torch.tensor(truth[LOCALIZED]).split(count.tolist())
        free = torch.tensor([int((~held).cumprod(0).sum()) for held in flags])
        targets = Targets(path, length, free, path, torch.full_like(length, NEVER))
        places = _tensor(truth[TARGET_POSE])[:, :3][index]
        return cls(
            replace(episodes, targets=targets), named, _teacher_of(config.rig, constants), places
        )


def _teacher_of(rig: Rig, constants: dict[str, list[Any]]) -> Teacher:
    """Return the teacher of a dataset with these constants of its episodes."""
    joints = (_tensor(constants[name]) for name in (OPEN_JOINTS, CLOSED_JOINTS))
    kind, radius_m = (Grip, GRIP_M) if rig.capture == CONTACT else (Teacher, rig.radius_m)
    return kind(
        rig.fps,
        rig.step_m,
        *(angles.quantile(CLOSED_QUANTILE, dim=0) for angles in joints),
        radius_m=radius_m,
    )


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
    if (found := told.get("schema")) != SCHEMA:
        raise ValueError(
            f"{manifest} has schema {found!r}, and this policy reads schema {SCHEMA}; generate the "
            "dataset again"
        )
    for key in ("provenance", "recording", "recipe", "rules"):
        told = told.get(key) or {}
    return told


def describe(meta: Any, cameras: list[str]) -> Rig:
    """Return what a dataset says of its clock, its cameras, its hand and its targets."""
    views, calibration = {key: key.split(".")[-1] for key in cameras}, {}
    of_cameras = {
        name.format(view) for view in views.values() for name in (CAMERA_POSE, CAMERA_INTRINSICS)
    }
    constants = _table(meta, CONSTANTS, of_cameras | {HAND_LIMITS, TARGET_PATH})
    captures = _table(meta, EPISODES, {CAPTURE}).get(CAPTURE)
    if captures and not constants:
        logging.warning(
            "%s is gone, which LeRobot's tools drop when they edit a dataset: only actions are "
            "learned",
            meta.root / CONSTANTS,
        )
    for key, view in views.items():
        if CAMERA_POSE.format(view) in constants:
            pose = constants[CAMERA_POSE.format(view)][0]
            focal_px, _, centre_px, _ = constants[CAMERA_INTRINSICS.format(view)][0]
            calibration[key] = [*pose, centre_px / focal_px, float(view == CARRIED_VIEW)]
    speed, _, latency_ms = constants.get(HAND_LIMITS, [(0.0, 0.0, 0.0)])[0]
    # with the palm's displacement as action (control mode grasp), the teachers' answers would be of
    # another kind
    absolute = meta.features[ACTION]["shape"] == meta.features.get("observation.state", {}).get(
        "shape"
    )
    capture = captures[0] if captures and TARGET_PATH in constants and absolute else ""
    return Rig(
        fps=float(meta.fps),
        calibration=calibration,
        delay_frames=math.ceil(latency_ms / 1000 * meta.fps - 1e-6),
        palm_speed_m_s=float(speed),
        capture=capture,
        radius_m=RADIUS_M.get(capture, Rig.radius_m),
    )


# -- the tables of a dataset -----------------------------------------------------------------------


def _table(meta: Any, folder: str, wanted: set[str]) -> dict[str, list[Any]]:
    """Return those of the ``wanted`` columns that the table in a folder's files has, in the order
    of episodes and their frames; nothing if the dataset has no such table.
    """
    if not (meta.root / folder).is_dir():
        return {}
    held = pq.ParquetDataset(meta.root / folder).schema.names
    order = [key for key in ("episode_index", "frame_index") if key in held]
    table = pq.read_table(meta.root / folder, columns=[*{*order, *wanted.intersection(held)}])
    table = table.sort_by([(key, "ascending") for key in order])
    return {name: table[name].to_pylist() for name in wanted.intersection(held)}


def _tensor(rows: list[Any]) -> Tensor:
    """Return rows of numbers as (n, D) float32."""
    return torch.from_numpy(np.array(rows, np.float32)).reshape(len(rows), -1)


# -- its images, encoded ---------------------------------------------------------------------------


def encoded_images(meta: Any, config: ObActConfig, model: ObActModel, lengths: list[int]) -> Tensor:
    """Return the sightings of all frames, ``(N, C, 5 + E)`` float32, of episodes of these
    ``lengths`` [frames].

    With ``config.cache_images`` they come from the cache, or go there. Whatever is wrong with a
    file of the cache, or with its folder, is reported once and costs no more than encoding again.
    """
    file, told = HF_LEROBOT_HOME / CACHE / f"{_fingerprint(meta, config, model)}.safetensors", False
    if config.cache_images and os.path.lexists(file):
        try:
            return _cached(file, (sum(lengths), len(config.cameras)))
        except Exception as error:  # of the file system, or of a reader of damaged files
            logging.warning(
                "the images are encoded again, because %s is of no use: %s", file, error
            )
            told = True
    found = []
    with torch.no_grad(), torch.autocast(model.device.type, enabled=False):
        episodes = zip(*(_images(meta, key, lengths) for key in config.cameras), strict=True)
        for seen in tqdm(
            episodes, desc="encoding", total=len(lengths), unit="episode", disable=None
        ):
            images = {key: x.to(model.device) for key, x in zip(config.cameras, seen, strict=True)}
            before = {key: torch.cat([x[:1], x[:-1]]) for key, x in images.items()}
            found.append(model.encode_images(images, before).float().cpu())
    sightings = torch.cat(found)
    if config.cache_images:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(f".{os.getpid()}.part")
            part.write_bytes(save({SIGHTINGS: sightings}))
            part.replace(file)  # so that the file is there whole or not at all
        except OSError as error:
            if not told:
                logging.warning("the encoded images are not kept for the next run: %s", error)
    return sightings


def _cached(file: Path, size: tuple[int, int]) -> Tensor:
    """Return the sightings in a file of the cache, of so many frames and cameras, ``(N, C, 5 +
    E)``.
    """
    if not file.is_file():
        raise ValueError("it is no file")
    if file.stat().st_uid != os.getuid():
        raise PermissionError("it belongs to another user")
    sightings = load_file(file)[SIGHTINGS]
    if (
        sightings.dtype != torch.float32
        or sightings.shape[:2] != size
        or not sightings.isfinite().all()
    ):
        raise ValueError(
            f"it holds {sightings.dtype} {tuple(sightings.shape)}, not finite float32 of {size}"
        )
    return sightings


def _fingerprint(meta: Any, config: ObActConfig, model: ObActModel) -> str:
    """Return what the sightings follow from: the dataset's files and the encoder's weights."""
    digest = hashlib.sha256(
        json.dumps([config.encoder, config.encoder_options, config.cameras]).encode()
    )
    for file in sorted(Path(meta.root).glob("**/*")):
        if file.suffix in (".mp4", ".parquet"):
            size = file.stat().st_size
            digest.update(f"{file.relative_to(meta.root)} {size}".encode())
            with file.open("rb") as opened:
                opened.seek(max(0, size - TAIL_BYTES))
                digest.update(opened.read())
    for parameter in model.encoders.state_dict().values():
        digest.update(parameter.cpu().numpy().tobytes())
    return digest.hexdigest()[:32]


def _images(meta: Any, key: str, lengths: list[int]) -> Iterator[Tensor]:
    """Yield the images of a camera by episode, in [0, 1], ``(T, 3, H, W)``."""
    if key not in meta.video_keys:
        dataset: Any = LeRobotDataset(meta.repo_id, root=meta.root).hf_dataset.select_columns(key)
        images = (row[key] for row in dataset)
        for length in lengths:
            yield torch.stack(list(islice(images, length)))
        return
    for episode, length in enumerate(lengths):
        start_s = meta.episodes[episode][f"videos/{key}/from_timestamp"]
        times_s = [start_s + frame / meta.fps for frame in range(length)]
        yield decode_video_frames(
            meta.root / meta.get_video_file_path(episode, key), times_s, 0.5 / meta.fps, "pyav"
        )
