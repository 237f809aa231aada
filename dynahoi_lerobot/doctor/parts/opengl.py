"""OpenGL, which only the renderer of that name needs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part

TIMEOUT_S = 60.0
PROBE = """
import mujoco
from dynahoi_lerobot.renderers.opengl import open_context
open_context(mujoco.MjModel.from_xml_string("<mujoco/>"), 16)
"""


@part("opengl")
def opengl(folder: Path) -> Iterator[Fact]:
    """Yield whether a context can be opened; another process tries, since a broken driver may end it."""
    del folder
    try:
        done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, timeout=TIMEOUT_S, check=False)
        works = done.returncode == 0
    except subprocess.TimeoutExpired:
        works = False
    follows = "the renderer `opengl` works, too" if works else "all renderers but `opengl` work"
    yield Fact("OpenGL", "works" if works else "none", follows)
