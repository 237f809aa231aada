"""The parts of a machine that ``dynahoi doctor`` examines: each is a function that yields facts."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distributions, entry_points, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from dynahoi_lerobot.core.registry import GROUP, Registry, import_plugin
from dynahoi_lerobot.dataset.codecs import CODECS, Encoding
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe


@dataclass(frozen=True)
class Fact:
    """One finding about this machine.

    Attributes:
        name: what was examined.
        found: what is there, with units.
        follows: the consequence for the commands; empty if none.
        problem: whether the installed commands need something that is missing or wrong.
    """

    name: str
    found: str
    follows: str = ""
    problem: bool = False


Look = Callable[[Path], Iterator[Fact]]
"""Takes the output folder."""

PARTS: Registry[Look] = Registry("part", "dynahoi_lerobot.doctor.parts")


def part(name: str) -> Callable[[Look], Look]:
    """Return a decorator that registers the part ``name``."""
    return PARTS.register(name)


def examine(folder: Path) -> Iterator[Fact]:
    """Yield the facts of every part; a part that raises is a problem.

    Args:
        folder: output folder.
    """
    for name, look in PARTS.items():
        try:
            yield from look(folder)
        except Exception as error:  # whatever a broken installation raises is what the user wants to know
            yield Fact(name, f"check failed: {type(error).__name__}: {error}", problem=True)


WORKER_GB = 0.9
"""Memory of a process of ``dynahoi generate`` at 128 px (docs/notes/scale.md)."""


@part("processor")
def processor(folder: Path) -> Iterator[Fact]:
    """Yield the available cores and the memory."""
    del folder
    count = cores()
    memory_gb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    workers = max(1, min(count, int(memory_gb / WORKER_GB)))
    yield Fact("cores", f"{count}, {platform.machine()}", f"`dynahoi generate --workers {workers}`")
    enough = memory_gb >= WORKER_GB
    yield Fact("memory", f"{memory_gb:.1f} GB", "" if enough else f"a worker needs {WORKER_GB} GB", problem=not enough)


def cores() -> int:
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


WRITTEN_MB, BLOCK_MB = 64, 4
FRAME_BYTES, EPISODE_FRAMES = 1200, 66
"""Of a dataset at 128 px (docs/notes/scale.md)."""
LEAST_GB = 0.5
"""What the quickstart and the compiled kernels need."""


@part("disk")
def disk(folder: Path) -> Iterator[Fact]:
    """Yield free space and sequential write speed (with fsync) of the nearest existing folder."""
    place = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.is_dir())
    free_gb = shutil.disk_usage(place).free / 1e9
    episodes = int(free_gb * 1e9 / (FRAME_BYTES * EPISODE_FRAMES))
    enough = free_gb >= LEAST_GB
    room = f"room for about {_rounded(episodes):,} episodes at 128 px" if enough else f"{LEAST_GB} GB are needed"
    yield Fact("disk", f"{free_gb:.1f} GB free in {place}", room, problem=not enough)
    if enough:
        yield Fact("write speed", f"{write_speed_mb_s(place):.0f} MB/s")


def write_speed_mb_s(folder: Path) -> float:
    """Return the write speed of a 64 MB file [MB/s].

    Raises:
        OSError: if the folder is not writable.
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


@part("gpu")
def gpu(folder: Path) -> Iterator[Fact]:
    """Yield the devices of Warp, on which images are rendered, and of torch, on which policies run."""
    del folder
    from dynahoi_lerobot.renderers.device import wp

    found = [f"{device.name}, {device.total_memory / 1e9:.0f} GB" for device in wp.get_cuda_devices()]
    where = "CUDA" if found else "the CPU"
    yield Fact("GPU", "; ".join(found) or "none", f"the renderer `tiles` runs on {where}; it needs no OpenGL")
    if importlib.util.find_spec("torch") is not None:
        yield _torch(bool(found))


def _torch(expected: bool) -> Fact:
    """Return where policies run; warn of a GPU that torch cannot use."""
    import torch

    if torch.cuda.is_available():
        return Fact("torch device", f"CUDA {torch.version.cuda}", "policies run on the GPU")
    wanted = "; install a torch with CUDA to use the GPU" if expected else ""
    return Fact("torch device", "CPU", f"policies run on the CPU{wanted}")


TIMEOUT_S = 60.0
PROBE = """
import mujoco
from dynahoi_lerobot.renderers.opengl import open_context
open_context(mujoco.MjModel.from_xml_string("<mujoco/>"), 16)
"""


@part("opengl")
def opengl(folder: Path) -> Iterator[Fact]:
    """Yield whether a context can be opened; a subprocess tries, because a broken driver may crash it."""
    del folder
    try:
        done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, timeout=TIMEOUT_S, check=False)
        works = done.returncode == 0
    except subprocess.TimeoutExpired:
        works = False
    follows = "the renderer `opengl` works" if works else "all renderers but `opengl` work"
    yield Fact("OpenGL", "works" if works else "none", follows)


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
    """Return whether torchcodec can be imported."""
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


CORE = "dynahoi_lerobot"
PLUGINS = ("lerobot_env_dynahoi", "lerobot_policy_tracker")
OPTIONAL = {
    "lerobot": "training and LeRobot's commands need it: pip install '.[lerobot]', in a checkout",
    "torch": "comes with lerobot",
}
"""Optional libraries and their purpose."""
SHOWN = ("mujoco", "mujoco-warp", "warp-lang", "gymnasium", "numpy", *OPTIONAL)


@part("versions")
def versions(folder: Path) -> Iterator[Fact]:
    """Yield the versions of Python, the distributions and their requirements; report those out of bounds."""
    del folder
    yield Fact("Python", platform.python_version())
    wanted = requirements()
    names = [CORE, *PLUGINS, *SHOWN]
    for name in [*names, *sorted(wanted.keys() - set(names))]:
        if (fact := _library(name, wanted.get(name, []))) is not None:
            yield fact


def requirements() -> dict[str, list[Requirement]]:
    """Return the requirements of the installed distributions, without extras, by name."""
    found: dict[str, list[Requirement]] = {}
    for distribution in (CORE, *PLUGINS):
        if installed_version(distribution) is None:
            continue
        for requirement in map(Requirement, requires(distribution) or ()):
            if requirement.marker is None or requirement.marker.evaluate():
                found.setdefault(requirement.name, []).append(requirement)
    return found


def _library(name: str, wanted: list[Requirement]) -> Fact | None:
    """Return the fact about a library; None if it is fine and not in ``SHOWN``."""
    found = installed_version(name)
    bounds = ", ".join(str(requirement.specifier) for requirement in wanted if requirement.specifier)
    if found is None:
        if not wanted:
            return Fact(name, "none", OPTIONAL[name]) if name in OPTIONAL else None
        return Fact(name, "none", f"install it: pip install {str(wanted[0])!r}", problem=True)
    if any(not requirement.specifier.contains(found, prereleases=True) for requirement in wanted):
        return Fact(name, found, f"needs {bounds}: pip install {str(wanted[0])!r}", problem=True)
    return Fact(name, found) if name in (CORE, *PLUGINS, *SHOWN) else None


def installed_version(name: str) -> str | None:
    """Return the version of an installed distribution; None if there is none of that name."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


LEROBOT_PREFIXES = ("lerobot_env_", "lerobot_policy_", "lerobot_robot_", "lerobot_teleoperator_", "lerobot_camera_")
"""Names by which LeRobot finds its plugins."""


@part("plugins")
def plugins(folder: Path) -> Iterator[Fact]:
    """Yield the distributions that LeRobot imports as plugins, and the modules that the core imports."""
    del folder
    found = {(dist.name, dist.version) for dist in distributions() if dist.name.startswith(LEROBOT_PREFIXES)}
    for name, installed in sorted(found):
        yield Fact(name, installed, "LeRobot finds it")
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            import_plugin(entry)
        yield Fact(
            f"plugin {entry.name}", entry.value, *[str(warning.message) for warning in told][:1], problem=bool(told)
        )


RECIPE = Recipe(image_size=64)
EPISODES = 16
KNOWN_FRAMES_S = 593.0
"""Speed of a core of the machine on which the quickstart was timed."""
KNOWN_PROCESSOR_S, KNOWN_ELAPSED_S = 400.0, 276.0
"""Duration of the quickstart there: processor time, and wall time on two idle cores."""


@part("pace")
def pace(folder: Path) -> Iterator[Fact]:
    """Yield the speed over some episodes of ``train``, sampling included, and an estimate from it."""
    del folder
    frames_s = frames_per_s()
    found = f"{frames_s:.0f} frames/s per core at {RECIPE.image_size} px"
    yield Fact("pace", found, f"the quickstart takes about {max(1.0, quickstart_s(frames_s, cores()) / 60):.0f} min")


def quickstart_s(frames_s: float, idle_cores: int) -> float:
    """Return the estimated duration of the quickstart [s]; more than two cores count as two.

    Args:
        frames_s: pace of a core [frames/s], as ``frames_per_s`` measures it.
        idle_cores: how many there are.
    """
    known_s = KNOWN_PROCESSOR_S if idle_cores == 1 else KNOWN_ELAPSED_S
    return known_s * KNOWN_FRAMES_S / frames_s


def frames_per_s() -> float:
    """Return the frames that one thread simulates and renders per second of processor time."""
    for _ in record(RECIPE, [0], threads=1):  # compiles the scene and, once on a machine, the renderer
        pass
    start = time.process_time()
    frames = sum(len(episode) for episode in record(RECIPE, range(1, 1 + EPISODES), threads=1))
    return frames / (time.process_time() - start)
