"""All images of a dataset, encoded once, and kept on disk for the next run with the same images and weights."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq
import torch
from lerobot.datasets.video_utils import decode_video_frames
from lerobot.utils.constants import HF_LEROBOT_HOME
from safetensors.torch import load_file, save
from torch import Tensor
from torchvision.io import ImageReadMode, decode_image
from tqdm import tqdm

if TYPE_CHECKING:
    from .configuration_obact import ObActConfig
    from .modeling_obact import ObActModel

CACHE = "obact_sightings"
"""Folder of the cache, beside LeRobot's datasets."""
SIGHTINGS = "sightings"
TAIL_BYTES = 65536
"""Of a file that tell it from others: a video's index, a table's footer."""


def encoded_images(meta: Any, config: ObActConfig, model: ObActModel, lengths: list[int]) -> Tensor:
    """Return the sightings of all frames, ``(N, C, 5 + E)`` float32.

    With ``config.cache_images`` they come from the cache, or go there. Whatever is wrong with a file of the cache, or
    with its folder, is reported once and costs no more than encoding again.

    Args:
        meta: LeRobot's metadata of a dataset on this disk.
        config: of the policy.
        model: whose encoders are used.
        lengths: frames of each episode.
    """
    file = HF_LEROBOT_HOME / CACHE / f"{_fingerprint(meta, config, model)}.safetensors"
    size, found, told = (sum(lengths), len(config.cameras), model.n_sighting), [], False
    if config.cache_images and os.path.lexists(file):
        try:
            return _read(file, size)
        except Exception as error:  # of the file system, or of a reader of damaged files
            logging.warning("the images are encoded again, because %s is of no use: %s", file, error)
            told = True
    with torch.no_grad(), torch.autocast(model.device.type, enabled=False):
        for episode, length in enumerate(tqdm(lengths, desc="encoding", unit="episode", disable=None)):
            images = {key: _images(meta, key, episode, length).to(model.device) for key in config.cameras}
            if model.sees_motion:
                images = {key: torch.cat([x, torch.cat([x[:1], x[:-1]])], dim=1) for key, x in images.items()}
            found.append(model.encode_images(images).float().cpu())
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
