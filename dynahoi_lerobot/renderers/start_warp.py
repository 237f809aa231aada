"""Warp, started without its notice of a missing CUDA driver; import this before a module with kernels."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp

NO_CUDA = b"Could not find or load the NVIDIA CUDA driver"
"""Warp's native library writes this on every machine without a GPU, whatever the log level."""


@contextmanager
def _without_line(holding: bytes) -> Iterator[None]:
    """Drop lines with ``holding`` from what native code writes to standard error meanwhile, and pass on all others."""
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


wp.config.log_level = wp.LOG_WARNING  # before Warp is initialised
with _without_line(NO_CUDA):
    wp.init()
