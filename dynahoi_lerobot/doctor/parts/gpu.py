"""The GPU, as the renderer and as torch see it."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part


@part("gpu")
def gpu(folder: Path) -> Iterator[Fact]:
    """Yield the devices of Warp, on which images are rendered, and of torch, on which policies run."""
    del folder
    from dynahoi_lerobot.renderers.start_warp import wp

    found = [f"{device.name}, {device.total_memory / 1e9:.0f} GB" for device in wp.get_cuda_devices()]
    where = "CUDA" if found else "the CPU"
    yield Fact("GPU", "; ".join(found) or "none", f"the renderer `tiles` draws on {where}; it needs no OpenGL")
    if importlib.util.find_spec("torch") is not None:
        yield _torch(bool(found))


def _torch(expected: bool) -> Fact:
    """Return where policies run; a GPU that torch cannot use is worth a word."""
    import torch

    if torch.cuda.is_available():
        return Fact("torch device", f"CUDA {torch.version.cuda}", "policies run on the GPU")
    wanted = "; this torch has no CUDA for the GPU: install one that has" if expected else ""
    return Fact("torch device", "CPU", f"policies run on the CPU{wanted}")
