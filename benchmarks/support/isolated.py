"""Measure in a process of its own: nothing warmed up by, and no memory left from, what was measured
before.
"""

import multiprocessing
import os
import resource
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

os.environ.setdefault(
    "MUJOCO_GL", "egl"
)  # the fastest that needs no display; MuJoCo reads it when first imported


def measure_apart(task: Callable[..., dict[str, float]], *args: Any) -> dict[str, float]:
    """Return ``task(*args)`` and the ``peak_mb`` of the largest process that it took."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_measure, task, args).result()


def _measure(task: Callable[..., dict[str, float]], args: tuple[Any, ...]) -> dict[str, float]:
    result = task(*args)
    used = (
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return result | {"peak_mb": max(used) / 1024}
