"""The disk below the folder for output: room and write speed."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part

WRITTEN_MB, BLOCK_MB = 64, 4
FRAME_BYTES, EPISODE_FRAMES = 1200, 66
"""Of a dataset at 128 px (docs/notes/scale.md)."""
LEAST_GB = 0.5
"""What the quickstart and the compiled kernels need."""


@part("disk")
def disk(folder: Path) -> Iterator[Fact]:
    """Yield free space and sequential write speed, data brought to the disk, of the nearest folder that exists."""
    place = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.is_dir())
    free_gb = shutil.disk_usage(place).free / 1e9
    episodes = int(free_gb * 1e9 / (FRAME_BYTES * EPISODE_FRAMES))
    enough = free_gb >= LEAST_GB
    room = f"room for about {_rounded(episodes):,} episodes at 128 px" if enough else f"{LEAST_GB} GB are needed"
    yield Fact("disk", f"{free_gb:.1f} GB free in {place}", room, problem=not enough)
    if enough:
        yield Fact("write speed", f"{write_speed_mb_s(place):.0f} MB/s")


def write_speed_mb_s(folder: Path) -> float:
    """Return how fast a file of 64 MB is written to the disk [MB/s].

    Raises:
        OSError: if no file can be written there.
    """
    block = os.urandom(BLOCK_MB * 10**6)
    with tempfile.TemporaryFile(dir=folder) as file:
        start = time.perf_counter()
        for _ in range(WRITTEN_MB // BLOCK_MB):
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
        return WRITTEN_MB / (time.perf_counter() - start)


def _rounded(count: int) -> int:
    """Return a count to two digits."""
    digits = max(0, len(str(count)) - 2)
    return count // 10**digits * 10**digits
