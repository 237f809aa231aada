"""Video: what writes datasets (PyAV), and what LeRobot reads them with (torchcodec or PyAV)."""

from __future__ import annotations

import importlib
import importlib.util
import shutil
import subprocess
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from dynahoi_lerobot.dataset.codecs.base import CODECS, Encoding
from dynahoi_lerobot.doctor.parts.base import Fact, part


@part("codecs")
def codecs(folder: Path) -> Iterator[Fact]:
    """Yield PyAV with the encoders it has, torchcodec and ffmpeg."""
    del folder
    yield _pyav()
    if importlib.util.find_spec("lerobot") is not None:
        yield _torchcodec()
    yield Fact("ffmpeg", _ffmpeg() or "none", "only torchcodec uses its libraries")


def _pyav() -> Fact:
    import av.codec

    wanted = {name: codec.encoder for name, codec in CODECS.items() if codec.is_video}
    held = [name for name, encoder in wanted.items() if encoder in av.codec.codecs_available]
    default = Encoding.codec in held
    follows = f"`dynahoi generate` writes {Encoding.codec}" if default else "only `--codec images` works"
    return Fact("PyAV", f"{version('av')}, writes {', '.join(held) or 'no video'}", follows, problem=not default)


def _torchcodec() -> Fact:
    """Return whether torchcodec works, which it tells by being imported."""
    if importlib.util.find_spec("torchcodec") is None:
        return Fact("torchcodec", "none", "LeRobot decodes with PyAV")
    try:
        importlib.import_module("torchcodec")
    except (ImportError, OSError, RuntimeError):
        told = "LeRobot decodes with PyAV, slower; install FFmpeg's libraries for torchcodec"
        return Fact("torchcodec", f"{version('torchcodec')}, finds no FFmpeg libraries", told)
    return Fact("torchcodec", version("torchcodec"), "LeRobot decodes with torchcodec")


def _ffmpeg() -> str | None:
    program = shutil.which("ffmpeg")
    if program is None:
        return None
    said = subprocess.run([program, "-version"], capture_output=True, text=True, check=False).stdout
    return " ".join(said.split()[:3])
