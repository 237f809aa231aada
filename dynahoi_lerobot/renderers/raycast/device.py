"""Warp, started without its notice of a missing CUDA driver, and device copies of a batch's
per-world fields.
"""

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import numpy as np
import warp as wp
from mujoco.batch import Batch

from dynahoi_lerobot.core.caches import ensure_caches

NO_CUDA = b"Could not find or load the NVIDIA CUDA driver"
"""Warp's native library writes this on every machine without a GPU, whatever the log level."""


@contextmanager
def _without_line(holding: bytes) -> Iterator[None]:
    """Drop lines with ``holding`` from what native code writes to standard error meanwhile, and
    pass on all others.
    """
    sys.stderr.flush()
    with tempfile.TemporaryFile() as held:
        stderr = os.dup(2)
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            held.seek(0)
            os.write(2, b"".join(line for line in held if holding not in line))


ensure_caches()
wp.config.log_level = wp.LOG_WARNING  # before Warp is initialized
with _without_line(NO_CUDA):
    wp.init()


class Mirror:
    """Device arrays that are refreshed from arrays of the batch; only the rows of the worlds copied
    last are in use.
    """

    def __init__(self, sources: dict[str, np.ndarray], arrays: dict[str, wp.array]) -> None:
        """Pair each device array with the source of the same name.

        Args:
            sources: (N, ...) arrays of the batch, views that follow the simulation.
            arrays: device arrays of N rows.
        """
        self._fields = []
        for name, array in arrays.items():
            staging = array if str(array.device) == "cpu" else wp.empty_like(array, device="cpu")
            self._fields.append((sources[name], staging.numpy(), staging, array))

    def copy(self, ids: np.ndarray) -> None:
        """Copy the rows ``ids`` (n,) of every field into the first n rows of its device array."""
        n_worlds = len(ids)
        for source, rows, staging, array in self._fields:
            rows[:n_worlds] = source[ids].reshape(n_worlds, *rows.shape[1:])
            if staging is not array:
                wp.copy(array[:n_worlds], staging[:n_worlds])  # type: ignore[arg-type] - slices of arrays are arrays


def world_fields(
    batch: Batch, model_fields: Iterable[str], data_fields: Iterable[str]
) -> dict[str, np.ndarray]:
    """Return (N, ...) views of the batch's per-world model fields and of its data fields, by
    name.
    """
    return {name: batch.expand(name) for name in model_fields} | {
        name: batch.bind(name) for name in data_fields
    }


def default_device() -> str:
    """Return warp's name of the device to render on: ``cuda`` if there is one, else ``cpu``."""
    return "cuda" if wp.is_cuda_available() else "cpu"
