"""Cores and memory."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part

WORKER_GB = 0.9
"""Memory of a process of ``dynahoi generate`` at 128 px (docs/notes/scale.md)."""


@part("processor")
def processor(folder: Path) -> Iterator[Fact]:
    """Yield the cores that this process may use, and the machine's memory."""
    del folder
    count = cores()
    memory_gb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    workers = max(1, min(count, int(memory_gb / WORKER_GB)))
    yield Fact("cores", f"{count}, {platform.machine()}", f"`dynahoi generate --workers {workers}`")
    enough = memory_gb >= WORKER_GB
    yield Fact("memory", f"{memory_gb:.1f} GB", "" if enough else f"a worker needs {WORKER_GB} GB", problem=not enough)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
