"""A lock file that one process at a time holds; the kernel releases it when its holder ends, however that happens."""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from dynahoi_lerobot.generate.plan import GenerationError


@contextmanager
def exclusive(path: Path) -> Iterator[None]:
    """Hold the lock file ``path`` for the length of a ``with`` block.

    Raises:
        GenerationError: if another process holds it.
    """
    file = _locked(path)
    try:
        file.truncate()
        file.write(f"process {os.getpid()} on {socket.gethostname()}")
        file.flush()
        yield
    finally:
        path.unlink(missing_ok=True)
        file.close()


def _locked(path: Path) -> TextIO:
    """Open and lock the file, again if its last holder removed it in between."""
    while True:
        file = path.open("a+")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read() or "another process"
            file.close()
            raise GenerationError(f"{holder} is generating into {path.parent}; wait for it to end") from None
        if path.exists() and os.path.samestat(path.stat(), os.fstat(file.fileno())):
            file.seek(0)
            return file
        file.close()
