"""Every video file holds exactly its episodes' frames."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset
from dynahoi_lerobot.verify.mp4 import container_problems

EXACT_S = 1e-6
"""Times that differ by less are the same [s]: tools that append episodes add up times."""


@CHECKS.register("videos")
class Videos(Check):
    """Reads every packet of every video, without decoding: counts, times, key frames, size, rate and codec."""

    of_the_format = True

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield what is wrong with each file."""
        if not dataset.has_video:
            return
        for key in dataset.pictures:
            yield from _view(dataset, key)


def _view(dataset: CheckedDataset, key: str) -> Iterator[str]:
    """Yield what is wrong with the files of one view."""
    files: dict[Path, list[EpisodeRow]] = {}
    for row in dataset.rows:
        files.setdefault(dataset.video_path(row, key), []).append(row)
    for path, rows in files.items():
        name = path.relative_to(dataset.root)
        yield from (f"{name} {problem}" for problem in _ranges(rows, key))
        try:
            if dataset.has_manifest:  # other tools lay out a file as they like
                yield from (f"{name} {problem}" for problem in container_problems(path))
            yield from (f"{name} {problem}" for problem in _stream(path, rows, dataset.features[key], key))
        except (OSError, FFmpegError, IndexError, ValueError) as error:
            yield f"{name} cannot be read as a video: {error}"


def _ranges(rows: list[EpisodeRow], key: str) -> Iterator[str]:
    """Yield gaps and overlaps between the episodes of one file."""
    start = 0
    for row in rows:
        found = [row[f"videos/{key}/{end}_timestamp"] for end in ("from", "to")]
        wanted = [start / CONTROL_HZ, (start + row["length"]) / CONTROL_HZ]
        if not np.allclose(found, wanted, rtol=0.0, atol=EXACT_S):
            yield (
                f"is said to hold episode {row['episode_index']} from {found[0]:.2f} to {found[1]:.2f} s; its place is "
                f"{wanted[0]:.2f} to {wanted[1]:.2f} s"
            )
        start += row["length"]


def _stream(path: Path, rows: list[EpisodeRow], feature: dict[str, Any], key: str) -> Iterator[str]:
    wanted = sum(row["length"] for row in rows)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        found = (stream.height, stream.width, stream.codec_context.codec.canonical_name, stream.average_rate)
        expected = (*feature["shape"][:2], feature["info"]["video.codec"], CONTROL_HZ)
        if found != expected:
            yield f"has (height, width, codec, rate) {found}; info.json and the clock say {expected}"
        packets = [packet for packet in container.demux(stream) if packet.size]
        if len(packets) != wanted:
            yield f"holds {len(packets)} frames; its episodes have {wanted}"
            return
        gap = max(np.diff([*(n for n, packet in enumerate(packets) if packet.is_keyframe), len(packets)]), default=0)
        if gap > (most := feature["info"]["video.g"]):
            yield f"has {gap} frames from a key frame to the next; info.json says at most {most}"
        times = sorted(float((packet.pts or 0) * packet.time_base) for packet in packets)
        if any(abs(time - number / CONTROL_HZ) > EXACT_S for number, time in enumerate(times)):
            yield f"has frames that are not 1/{CONTROL_HZ} s apart"
        starts = {round(row[f"videos/{key}/from_timestamp"] * CONTROL_HZ) for row in rows}
        keys = {number for number, packet in enumerate(packets) if packet.is_keyframe}
        if starts - keys:
            yield f"has no key frame at frame {min(starts - keys)}, where an episode begins"
