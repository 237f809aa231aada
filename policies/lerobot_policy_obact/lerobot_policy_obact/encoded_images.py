"""All images of a dataset, encoded once, and kept on disk for the next run with the same images and weights."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Iterator
from itertools import dropwhile, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import av
import pyarrow.parquet as pq
import torch
from lerobot.utils.constants import HF_LEROBOT_HOME
from safetensors.torch import load_file, save
from torch import Tensor
from torchvision.io import ImageReadMode, decode_image
from tqdm import tqdm

from .encoders import N_SIGHTING, Encoder

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
