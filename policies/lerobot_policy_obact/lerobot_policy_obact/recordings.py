"""A whole dataset whose images were encoded once, to learn from; training only.

LeRobot hands out frames with the images of a window, which takes longer to read than to learn from. A frozen encoder
says the same of an image whenever it is asked, so with ``encode_once`` all frames are encoded before training begins
and kept in memory; a batch then only says which episodes to learn from. What a dataset of DynaHOI knows of its target
(the ``stats/`` columns of the episode table) is read at the same time and never becomes an observation.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from einops import rearrange, repeat
from lerobot.datasets.video_utils import decode_video_frames
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME
from safetensors.torch import load_file, save_file
from torch import Tensor
from torchvision.io import ImageReadMode, decode_image
from tqdm import tqdm

from dynahoi_lerobot.experts.match import SQUEEZE_RAD

from .belief import FORECAST_FRAMES
from .decisions import Decisions, Frames, Future
from .grips import grip_answers, grip_palms
from .teacher import answers, virtual_palms

if TYPE_CHECKING:
    from .configuration_obact import ObActConfig
    from .modeling_obact import ObActModel

CAMERA_POSE, CAMERA_INTRINSICS, HAND_LIMITS = "stats/{}_camera", "stats/{}_intrinsics", "stats/hand_limits"
TARGET_PATH, TARGET_POSE, LOCALIZED = "stats/target_path", "stats/target.pose", "stats/localized"
OPEN_JOINTS, CLOSED_JOINTS = "stats/open_joints", "stats/reference_joints"
"""Columns of the episode table of a DynaHOI dataset, see its feature table."""
TOUCH = "observation.touch"
"""What datasets of the contact track have alone."""
EARLY_SHARE, EARLIEST_FRAME = 0.15, 3
"""Share of the decisions that are taken anywhere in the observation window, and the first frame at which."""
CARRIED_VIEW = "ego"
"""The view of the camera that the palm carries."""
CLOSED_QUANTILE = 0.6
"""Objects differ by 6 % in how far a hand closes around them; closing a little too far grasps more of them."""
TAIL_BYTES = 65536
"""Of a file that tell it from others: a video's index, a table's footer."""


@dataclass(frozen=True)
class Targets:
    """What a dataset knows of its targets.

    Attributes:
        path: of the untouched target [m], ``(E, F, 3)``.
        length: known frames of that, ``(E,)``.
        free: frames until the hand touched the target, ``(E,)``.
        open_joints, closed_joints: of the hand [rad], ``(J,)``.
        carried: paths of targets that are held from frame ``contact`` ``(E,)`` on [m], ``(E, F, 3)``; None if none is.
    """

    path: Tensor
    length: Tensor
    free: Tensor
    open_joints: Tensor
    closed_joints: Tensor
    carried: Tensor | None = None
    contact: Tensor | None = None

    def held(self, frame: Tensor) -> Tensor:
        """Return whether targets are in the hand in frames ``(E, Q)``."""
        return torch.zeros_like(frame, dtype=torch.bool) if self.contact is None else frame >= self.contact[:, None]

    def places(self, frame: Tensor, seen_from: Tensor) -> Tensor:
        """Return where targets are in frames ``(E, Q, K)`` [m], ``(E, Q, K, 3)``.

        Seen from frames ``(E, Q)`` before the catch, that is the untouched path.
        """
        q = frame.shape[1]
        index = repeat(torch.minimum(frame, self.length[:, None, None] - 1), "b q k -> b (q k) i", i=3)
        place = rearrange(self.path.gather(1, index), "b (q k) i -> b q k i", q=q)
        if self.carried is None:
            return place
        carried = rearrange(self.carried.gather(1, index), "b (q k) i -> b q k i", q=q)
        return torch.where(self.held(seen_from)[..., None, None], carried, place)

    def closed_share(self, state: Tensor) -> Tensor:
        """Return how far the fingers of hands ``(..., S)`` are closed, 0 open, 1 closed, ``(...)``."""
        joints = state[..., 3 : 3 + len(self.open_joints)]
        return (joints - self.open_joints).sum(-1) / (self.closed_joints - self.open_joints).sum()

    def of(self, chosen: Tensor) -> Targets:
        """Return those of episodes ``(B,)``."""
        named = {name: getattr(self, name) for name in ("path", "length", "free", "carried", "contact")}
        return replace(self, **{name: x[chosen] for name, x in named.items() if x is not None})


@dataclass
class Recordings:
    """A dataset as tables: N frames of E episodes.

    Attributes:
        sightings: of all frames, ``(N, C, 5 + E')``.
        state: ``(N, S)``.
        actions: ``(N, A)``.
        first, frames: first frame and number of frames of each episode, ``(E,)``.
        window: frames of its observation window, ``(E,)``; 0 if there is none.
        named: episodes that a batch of the training has named, bool, ``(E,)``; nothing is learned from others.
        targets: what is known of the targets; None if the dataset does not say.
        places: where the targets were in all frames [m], ``(N, 3)``, where they are gripped; None elsewhere.
    """

    sightings: Tensor
    state: Tensor
    actions: Tensor
    first: Tensor
    frames: Tensor
    window: Tensor
    named: Tensor
    targets: Targets | None = None
    places: Tensor | None = None

    @property
    def known(self) -> Tensor:
        """The episodes that may be learned from: those named, ``(K,)``."""
        return self.named.nonzero()[:, 0]

    def decisions(self, chosen: Tensor, config: ObActConfig) -> Decisions:
        """Draw ``n_decisions`` decisions in each of episodes ``(B,)``."""
        late = config.delay_frames
        rows = self._decision_rows(chosen, config.n_decisions, late)  # (B, Q)
        frames = self._episodes(chosen, int(rows.max()) + 1 + late, config.fps)
        palm = frames.palm.gather(1, repeat(rows + late, "b q -> b q i", i=3))
        seen = frames.until(int(rows.max()))
        state = frames.state.gather(1, repeat(rows, "b q -> b q s", s=frames.state.shape[-1]))[:, :, None]
        if self.targets is None:
            ahead = rows[..., None] + torch.arange(config.horizon)  # (B, Q, H)
            last = self.frames[chosen, None, None] - 1
            actions = self.actions[self.first[chosen, None, None] + torch.minimum(ahead, last)]
            return Decisions(
                seen, rows, palm[:, :, None], state, actions[:, :, None], (ahead <= last).float()[:, :, None]
            )
        targets = self.targets.of(chosen)
        path, length = targets.path, targets.length
        due, step_m = torch.minimum(rows + late, length[:, None] - 2), config.palm_speed_m_s / config.fps
        if config.grips:
            palms = grip_palms(targets, due, palm)
            goal, closing, left = grip_answers(targets, due, palms, config.horizon)
            reachable, weight = torch.ones_like(left, dtype=torch.bool), torch.ones(left.shape)
        else:
            palms = virtual_palms(path, length, self.window[chosen], due, palm=palm, step_m=step_m)
            told = answers(path, length, due, palms, step_m)
            goal = repeat(told.meeting, "b q m i -> b q m h i", h=config.horizon)
            closing, left, reachable, weight = told.closing(config.horizon), told.frames, told.reachable, told.weight
        closed_joints = targets.closed_joints + (SQUEEZE_RAD if config.grips else 0.0)
        joints = torch.lerp(targets.open_joints, closed_joints, closing[..., None])
        index = rows[..., None] + torch.tensor(FORECAST_FRAMES)
        return Decisions(
            frames=seen,
            rows=rows,
            palm=palms,
            state=state.expand(-1, -1, palms.shape[2], -1),
            actions=torch.cat([goal, joints], dim=-1),
            weight=repeat(weight, "b q m -> b q m h", h=config.horizon),
            future=Future(
                place=targets.places(index, rows),
                known=index < length[:, None, None],
                near=_nearness(left + late, reachable),
            ),
        )

    def seen_otherwise(self, chosen: Tensor, targets: Targets, state: Tensor, sightings: Tensor) -> Recordings:
        """Return episodes ``(B,)`` as other hands would have recorded them.

        Args:
            chosen: the episodes.
            targets: of those.
            state: of the hands, ``(B, T, S)``.
            sightings: what they saw, ``(B, T, C, 5)``.
        """
        n, t = state.shape[:2]
        return replace(
            self,
            sightings=rearrange(sightings, "b t c i -> (b t) c i"),
            state=rearrange(state, "b t s -> (b t) s"),
            first=torch.arange(n) * t,
            frames=torch.full((n,), t),
            window=self.window[chosen],
            targets=replace(targets, free=torch.minimum(targets.free, targets.length.clamp_max(t))),
        )

    @classmethod
    def encoded(cls, meta: Any, config: ObActConfig, model: ObActModel) -> Recordings:
        """Return a dataset with all its images encoded, or as an earlier run with the same images and weights found
        them.

        Args:
            meta: LeRobot's metadata of a dataset on this disk.
            config: of the policy.
            model: whose encoders are used.
        """
        wanted = {"length", "window_frames", TARGET_PATH, LOCALIZED, OPEN_JOINTS, CLOSED_JOINTS}
        table = episode_columns(meta, wanted | ({TARGET_POSE} if config.grips else set()))
        columns = _frame_columns(meta, [*config.state_keys, ACTION])
        count = torch.tensor(table["length"])
        recordings = cls(
            sightings=_encoded_images(meta, config, model, table["length"]),
            state=torch.cat([columns[key] for key in config.state_keys], dim=-1),
            actions=columns[ACTION],
            first=count.cumsum(0) - count,
            frames=count,
            window=torch.tensor(table.get("window_frames", [0] * len(count))),
            named=torch.zeros(len(count), dtype=torch.bool),
        )
        if config.forecasts:
            paths = [torch.tensor(np.array(path, np.float32)).reshape(-1, 3) for path in table[TARGET_PATH]]
            joints = (torch.tensor(np.stack(table[name]), dtype=torch.float32) for name in (OPEN_JOINTS, CLOSED_JOINTS))
            recordings.targets = Targets(
                torch.nn.utils.rnn.pad_sequence(paths, batch_first=True),
                torch.tensor([len(path) for path in paths]),
                torch.tensor([_free_frames(flags) for flags in table[LOCALIZED]]),
                *(angles.quantile(CLOSED_QUANTILE, dim=0) for angles in joints),
            )
            if config.grips:
                poses = [np.array(poses, np.float32).reshape(-1, 7)[:, :3] for poses in table[TARGET_POSE]]
                recordings.places = torch.from_numpy(np.concatenate(poses))
        return recordings

    def _episodes(self, chosen: Tensor, n_frames: int, fps: float) -> Frames:
        """Return the first ``n_frames`` frames of episodes ``(B,)``; one that is over repeats its last frame."""
        ahead = torch.arange(n_frames)
        index = self.first[chosen, None] + torch.minimum(ahead, self.frames[chosen, None] - 1)
        return Frames(self.sightings[index], self.state[index], ahead / fps)

    def _decision_rows(self, chosen: Tensor, n: int, late: int) -> Tensor:
        """Draw frames at which decisions are taken in episodes ``(B,)``, ``(B, n)``: mostly where the hand may move."""
        last = self.frames[chosen] - 1 - late
        if self.targets is not None:
            last = torch.minimum(self.targets.length[chosen] - 3 - late, self.targets.free[chosen] - 1)
        last = last.clamp_min(EARLIEST_FRAME + 1)[:, None]
        start = torch.where(torch.rand(len(chosen), n) < EARLY_SHARE, EARLIEST_FRAME, self.window[chosen, None])
        start = torch.minimum(start, last - 1)
        return torch.minimum(start + (torch.rand(start.shape) * (last - start + 0.999)).long(), last)


def _nearness(frames: Tensor, reachable: Tensor) -> Tensor:
    """Return the weight of each time of the forecast for meetings in ``frames`` ``(B, Q, M)``, ``(B, Q, K)``."""
    left = frames.clamp_max(FORECAST_FRAMES[-1]).float()[..., None]
    weight = (1 - (torch.tensor(FORECAST_FRAMES) - left).abs() / (1 + 0.25 * left)).clamp_min(0)
    return (weight / weight.sum(-1, keepdim=True).clamp_min(1e-6) * reachable[..., None]).mean(2)


def episode_columns(meta: Any, wanted: set[str]) -> dict[str, list[Any]]:
    """Return those of the ``wanted`` columns of the episode table that the dataset has, in the order of episodes."""
    files = _episode_files(meta)
    held = [name for name in pq.read_schema(files[0]).names if name in wanted]
    columns = ["episode_index", *held]
    table = pa.concat_tables([pq.read_table(file, columns=columns) for file in files]).sort_by("episode_index")
    return {name: table[name].to_pylist() for name in held}


def _episode_files(meta: Any) -> list[Path]:
    return sorted(Path(meta.root).glob("meta/episodes/*/*.parquet"))


def describe(meta: Any, config: ObActConfig) -> None:
    """Write what a dataset says of its cameras, its clock, its hand and its target into the config."""
    config.fps = float(meta.fps)
    views = {key: key.split(".")[-1] for key in config.cameras}
    of_cameras = {name.format(view) for view in views.values() for name in (CAMERA_POSE, CAMERA_INTRINSICS)}
    table = episode_columns(meta, of_cameras | {HAND_LIMITS})
    for key, view in views.items():
        if pose := table.get(CAMERA_POSE.format(view)):
            focal_px, _, centre_px, _ = table[CAMERA_INTRINSICS.format(view)][0]
            config.calibration[key] = [*pose[0], centre_px / focal_px, float(view == CARRIED_VIEW)]
    if limits := table.get(HAND_LIMITS):
        config.palm_speed_m_s = float(limits[0][0])
        config.delay_frames = math.ceil(limits[0][2] / 1000 * config.fps - 1e-6)
    config.forecasts = (
        config.encode_once
        and config.forecast_weight > 0
        and TARGET_PATH in pq.read_schema(_episode_files(meta)[0]).names
    )
    config.grips = config.forecasts and TOUCH in meta.features


def _free_frames(localized: list[bool]) -> int:
    """Return for how many frames the target kept to its path."""
    return localized.index(True) if True in localized else len(localized)


def _frame_columns(meta: Any, keys: list[str]) -> dict[str, Tensor]:
    """Return columns of the frame table in the order of frames, ``(N, D)`` each."""
    files = sorted(Path(meta.root).glob("data/*/*.parquet"))
    table = pa.concat_tables([pq.read_table(file, columns=["index", *keys]) for file in files]).sort_by("index")
    return {key: torch.from_numpy(np.array(table[key].to_pylist(), np.float32)).reshape(len(table), -1) for key in keys}


def _encoded_images(meta: Any, config: ObActConfig, model: ObActModel, lengths: list[int]) -> Tensor:
    """Return the sightings of all frames, ``(N, C, 5 + E)``, kept beside LeRobot's datasets for the next run."""
    place = HF_LEROBOT_HOME / "obact_sightings" / f"{_fingerprint(meta, config, model)}.safetensors"
    if place.is_file():
        return load_file(place)["sightings"]
    logging.info("encoding %d frames once; the sightings are kept in %s", sum(lengths), place)
    found = []
    for episode, length in enumerate(tqdm(lengths, desc="encoding", unit="episode", disable=None)):
        images = {key: _images(meta, key, episode, length).to(model.device) for key in config.cameras}
        if model.sees_motion:
            images = {key: torch.cat([x, torch.cat([x[:1], x[:-1]])], dim=1) for key, x in images.items()}
        found.append(model.sight(images).cpu())
    sightings = torch.cat(found)
    place.parent.mkdir(parents=True, exist_ok=True)
    part = place.with_suffix(f".{os.getpid()}.part")
    save_file({"sightings": sightings}, part)
    part.replace(place)
    return sightings


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


def _images(meta: Any, key: str, episode: int, length: int) -> Tensor:
    """Return an episode's images of a camera, ``(T, 3, H, W)`` in [0, 1]."""
    if key in meta.video_keys:
        start = meta.episodes[episode][f"videos/{key}/from_timestamp"]
        times = [start + i / meta.fps for i in range(length)]
        path = Path(meta.root) / meta.get_video_file_path(episode, key)
        return decode_video_frames(path, times, tolerance_s=0.5 / meta.fps, backend="pyav")
    path = Path(meta.root) / meta.get_data_file_path(episode)
    cells = pq.read_table(path, columns=[key], filters=[("episode_index", "=", episode)])[key].to_pylist()
    encoded = (torch.frombuffer(bytearray(cell["bytes"]), dtype=torch.uint8) for cell in cells)
    return torch.stack([decode_image(image, ImageReadMode.RGB) for image in encoded]) / 255
