"""A whole dataset as tables, to learn from; training only.

LeRobot hands out frames with their images, which takes longer to read than to learn from. A frozen encoder says the
same of an image whenever it is asked, so all images are encoded before training begins, kept in memory, and on disk for
the next run with the same images and weights; a batch then only says which episodes there are. What a dataset of
DynaHOI knows of its targets (the ``stats/`` columns of the episode table) is read at the same time and never becomes an
observation.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import dropwhile, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME
from safetensors.torch import load_file, save
from torch import Tensor
from torchvision.io import ImageReadMode, decode_image
from tqdm import tqdm

from .configuration_obact import CONTACT, ObActConfig, Rig
from .decisions import Episodes
from .encoders import N_SIGHTING, Encoder
from .teacher import Grip, Targets, Teacher

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
SPREAD = 6
"""Of so many times more episodes than wanted, those of similar length are taken, which need little padding."""
CACHE, SIGHTINGS = "obact_sightings", "sightings"
"""Folder of the cache of encoded images, beside LeRobot's datasets, and the name of the tensor in a file of it."""
TAIL_BYTES = 65536
"""Of a file that tell it from others: a video's index, a table's footer."""


@dataclass
class Recordings:
    """All episodes of a dataset, E of at most T frames.

    Attributes:
        episodes: as they were recorded.
        named: those that a batch of the training has named, bool, ``(E,)``; nothing is learned from others.
        teacher: what to do about the targets; None if the dataset does not say where they are.
        places: where those were [m], ``(E, T, 3)``.
    """

    episodes: Episodes
    named: Tensor
    teacher: Teacher | None = None
    places: Tensor | None = None

    def draw(self, n: int) -> Episodes:
        """Draw n episodes of similar length that may be learned from."""
        known = self.named.nonzero()[:, 0]
        return self.episodes[similar(known[torch.randint(len(known), (SPREAD * n,))], self.episodes.count, n)]

    @classmethod
    def encoded(cls, meta: Any, config: ObActConfig, model: ObActModel) -> Recordings:
        """Return the dataset of LeRobot's metadata, which is on this disk, with all images encoded by the model."""
        known = {TARGET_PATH, LOCALIZED, OPEN_JOINTS, CLOSED_JOINTS, TARGET_POSE} if config.forecasts else set()
        table = episode_columns(meta, {"length", WINDOW} | known)
        columns = _frame_columns(meta, [*config.state_keys, ACTION])
        count = torch.tensor(table["length"])
        index = torch.minimum(torch.arange(int(count.max())), count[:, None] - 1) + (count.cumsum(0) - count)[:, None]
        state = torch.cat([columns[key] for key in config.state_keys], dim=-1)
        window = torch.tensor(table.get(WINDOW, [0] * len(count)))
        sightings = encoded_images(meta, config, model, table["length"])
        episodes = Episodes(sightings[index], state[index], columns[ACTION][index], count, window)
        named = torch.zeros(len(count), dtype=torch.bool)
        if not config.forecasts:
            return cls(episodes, named)
        paths = [torch.tensor(np.array(path, np.float32)).reshape(-1, 3) for path in table[TARGET_PATH]]
        length, path = torch.tensor([len(path) for path in paths]), torch.nn.utils.rnn.pad_sequence(paths, True)
        free = torch.tensor([flags.index(True) if True in flags else len(flags) for flags in table[LOCALIZED]])
        targets = Targets(path, length, free, path, torch.full_like(length, NEVER))
        poses = [np.array(poses, np.float32).reshape(-1, 7)[:, :3] for poses in table[TARGET_POSE]]
        places = torch.from_numpy(np.concatenate(poses))[index]
        return cls(replace(episodes, targets=targets), named, _teacher_of(config.rig, table), places)


def similar(candidates: Tensor, length: Tensor, n: int) -> Tensor:
    """Return n of several times n episodes, of similar ``length`` ``(E,)``, which is that of all episodes."""
    order = candidates[(length[candidates] + torch.rand(len(candidates))).argsort()]
    return order.view(-1, n)[torch.randint(len(order) // n, ())]


def _teacher_of(rig: Rig, table: dict[str, list[Any]]) -> Teacher:
    """Return the teacher of a dataset with the episode table ``table``."""
    joints = (torch.tensor(np.stack(table[name]), dtype=torch.float32) for name in (OPEN_JOINTS, CLOSED_JOINTS))
    kind, radius_m = (Grip, GRIP_M) if rig.capture == CONTACT else (Teacher, rig.radius_m)
    return kind(rig.fps, rig.step_m, *(angles.quantile(CLOSED_QUANTILE, dim=0) for angles in joints), radius_m=radius_m)


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


# -- the tables of a dataset ----------------------------------------------------------------------------------------


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


# -- its images, encoded --------------------------------------------------------------------------------------------


def encoded_images(meta: Any, config: ObActConfig, model: ObActModel, lengths: list[int]) -> Tensor:
    """Return the sightings of all frames, ``(N, C, 5 + E)`` float32.

    With ``config.cache_images`` they come from the cache, or go there. Whatever is wrong with a file of the cache, or
    with its folder, is reported once and costs no more than encoding again. ``lengths`` are the episodes' [frames].
    """
    file = HF_LEROBOT_HOME / CACHE / f"{_fingerprint(meta, config, model)}.safetensors"
    n_numbers = N_SIGHTING + cast(Encoder, model.encoders[0]).embedding
    size, found, told = (sum(lengths), len(config.cameras), n_numbers), [], False
    if config.cache_images and os.path.lexists(file):
        try:
            return _read(file, size)
        except Exception as error:  # of the file system, or of a reader of damaged files
            logging.warning("the images are encoded again, because %s is of no use: %s", file, error)
            told = True
    with torch.no_grad(), torch.autocast(model.device.type, enabled=False):
        episodes = zip(*(_images(meta, key, lengths) for key in config.cameras), strict=True)
        for seen in tqdm(episodes, desc="encoding", total=len(lengths), unit="episode", disable=None):
            images = {key: x.to(model.device) / 255 for key, x in zip(config.cameras, seen, strict=True)}
            before = {key: torch.cat([x[:1], x[:-1]]) for key, x in images.items()}
            found.append(model.encode_images(images, before).float().cpu())
    sightings = torch.cat(found)
    if config.cache_images:
        try:
            _write(file, sightings)
        except OSError as error:
            if not told:
                logging.warning("the encoded images are not kept for the next run: %s", error)
    return sightings


def _read(file: Path, size: tuple[int, ...]) -> Tensor:
    if not file.is_file():
        raise ValueError("it is no file")
    if file.stat().st_uid != os.getuid():
        raise PermissionError("it belongs to another user")
    sightings = load_file(file)[SIGHTINGS]
    if sightings.dtype != torch.float32 or sightings.shape != size or not sightings.isfinite().all():
        raise ValueError(f"it holds {sightings.dtype} {tuple(sightings.shape)}, not finite float32 {size}")
    return sightings


def _write(file: Path, sightings: Tensor) -> None:
    """Write a file whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(f".{os.getpid()}.part")
    try:
        part.write_bytes(save({SIGHTINGS: sightings}))
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _fingerprint(meta: Any, config: ObActConfig, model: ObActModel) -> str:
    """Return what the sightings follow from: the dataset's files and the encoder's weights."""
    digest = hashlib.sha256(json.dumps([config.encoder, config.encoder_options, config.cameras]).encode())
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
    """Yield the images of a camera by episode, ``(T, 3, H, W)`` uint8; each file is read once, in order."""
    return map(torch.stack, (_of_videos if key in meta.video_keys else _of_tables)(meta, key, lengths))


def _of_videos(meta: Any, key: str, lengths: list[int]) -> Iterator[list[Tensor]]:
    opened, half_s = None, 0.5 / meta.fps
    frames: Iterator[tuple[float, Tensor]] = iter(())
    for episode, length in enumerate(lengths):
        if (path := meta.get_video_file_path(episode, key)) != opened:
            opened, frames = path, _timed_frames(Path(meta.root) / path)
        start_s = meta.episodes[episode][f"videos/{key}/from_timestamp"]
        taken = list(islice(dropwhile(lambda timed, first_s=start_s - half_s: timed[0] < first_s, frames), length))
        if len(taken) < length or abs(taken[-1][0] - start_s - (length - 1) / meta.fps) > half_s:
            raise ValueError(f"{path} lacks images of episode {episode}, of {length} frames from {start_s:.3f} s on.")
        yield [image for _, image in taken]


def _timed_frames(file: Path) -> Iterator[tuple[float, Tensor]]:
    with av.open(file) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        for frame in container.decode(stream):
            yield frame.time or 0.0, torch.from_numpy(frame.to_ndarray(format="rgb24")).permute(2, 0, 1)


def _of_tables(meta: Any, key: str, lengths: list[int]) -> Iterator[list[Tensor]]:
    files = dict.fromkeys(meta.get_data_file_path(episode) for episode in range(len(lengths)))
    cells = (cell for file in files for cell in pq.read_table(Path(meta.root) / file, columns=[key])[key].to_pylist())
    encoded = (torch.frombuffer(bytearray(cell["bytes"]), dtype=torch.uint8) for cell in cells)
    images = (decode_image(image, ImageReadMode.RGB) for image in encoded)
    for length in lengths:
        yield list(islice(images, length))
