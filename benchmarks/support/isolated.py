"""Measure in a process of its own, in which nothing has been warmed up and no memory is left from
what was measured before, and add up the time that its parts take.
"""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from support.measures import largest_process_mb


def measure_apart(task: Callable[..., dict[str, float]], *args: Any) -> dict[str, float]:
    """Return ``task(*args)`` and the ``peak_mb`` of the largest process that it took."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_measure, task, args).result()


def _measure(task: Callable[..., dict[str, float]], args: tuple[Any, ...]) -> dict[str, float]:
    result = task(*args)
    return result | {"peak_mb": largest_process_mb()}


@contextmanager
def added(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Add the time that the block, or each call of the decorated function, takes to an entry."""
    begin = time.perf_counter()
    yield
    seconds[name] += time.perf_counter() - begin
