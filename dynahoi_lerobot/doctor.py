"""``dynahoi doctor``: check every part of this machine, and whether it reproduces our episodes."""

import hashlib
import importlib
import importlib.util
import json
import os
import platform
import shutil
import time
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import distributions, entry_points, requires, version
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from packaging.requirements import Requirement

from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.conventions import EGO_VIEW, HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.core.machine import cores
from dynahoi_lerobot.core.numerics import TOLERANCE
from dynahoi_lerobot.core.registry import GROUP, import_plugin
from dynahoi_lerobot.dataset.video import CODECS
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate, record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.fingerprint import LIBRARIES, installed_version
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch


@dataclass(frozen=True)
class Fact:
    """What was found of a part of this machine, what follows for the commands, and whether they
    need something else.
    """

    name: str
    found: str
    follows: str = ""
    problem: bool = False

    def __str__(self) -> str:
        """Return one line."""
        mark = "PROBLEM: " if self.problem else ""
        follows = f"  -> {self.follows}" if self.follows else ""
        return f"{self.name:<24} {mark}{self.found}{follows}"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi doctor``."""

    folder: Path = option(Path(), "output folder on the disk to check")
    reference: bool = option(
        False, "also run 44 episodes and compare them bit by bit with the reference"
    )
    json: Path | None = option(None, "also write the findings to this file")


def run(options: Options) -> int:
    """Print the findings; return the exit code: 0 without problems, 1 with problems."""
    check_output(options.folder)
    facts = []
    for fact in chain(
        examine(options.folder),
        compare(play(EPISODES), read_reference()) if options.reference else (),
    ):
        print(fact, flush=True)
        facts.append(fact)
    if options.json:
        options.json.write_text(
            json.dumps([asdict(fact) for fact in facts], indent=2) + "\n", encoding="utf-8"
        )
    problems = [fact.name for fact in facts if fact.problem]
    print(f"problems: {', '.join(problems)}" if problems else "no problems")
    return 1 if problems else 0


def examine(folder: Path) -> Iterator[Fact]:
    """Yield the facts of every part; the disk is the one that holds the output ``folder``. A part
    that raises is a problem.
    """
    parts = {
        "processor": processor(),
        "disk": disk(folder),
        "gpu": gpu(),
        "codecs": codecs(),
        "versions": versions(),
        "plugins": plugins(),
        "pace": pace(),
    }
    for name, facts in parts.items():
        try:
            yield from facts
        except (
            Exception
        ) as error:  # whatever a broken installation raises is what the user wants to know
            yield Fact(name, f"check failed: {type(error).__name__}: {error}", problem=True)


WORKER_GB, EPISODE_MB, LEAST_GB = 0.9, 0.13, 0.5
"""Memory of a process of ``dynahoi generate`` and size of an episode, at 128 px
(docs/notes/scale.md), and disk space that the quickstart and the compiled kernels need."""


def processor() -> Iterator[Fact]:
    """Yield the available cores and the memory."""
    count = cores()
    memory_gb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    room = int(memory_gb / WORKER_GB)
    yield Fact(
        "cores",
        f"{count}, {platform.machine()}",
        f"`dynahoi generate --workers {max(1, min(count, room))}`",
    )
    yield Fact(
        "memory",
        f"{memory_gb:.1f} GB",
        "" if room else f"a worker needs {WORKER_GB} GB",
        problem=not room,
    )


def disk(folder: Path) -> Iterator[Fact]:
    """Yield the free space of the nearest existing folder."""
    place = next(
        parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.is_dir()
    )
    free_gb = shutil.disk_usage(place).free / 1e9
    full = free_gb < LEAST_GB
    room = f"room for about {free_gb / EPISODE_MB:.0f} thousand episodes at 128 px"
    follows = f"{LEAST_GB} GB are needed" if full else room
    yield Fact("disk", f"{free_gb:.1f} GB free in {place}", follows, problem=full)


def gpu() -> Iterator[Fact]:
    """Yield the devices of Warp, on which images are rendered, and of torch, on which policies
    run.
    """
    from dynahoi_lerobot.renderers.raycast.device import wp

    found = [
        f"{device.name}, {device.total_memory / 1e9:.0f} GB" for device in wp.get_cuda_devices()
    ]
    where = "CUDA" if found else "the CPU"
    yield Fact(
        "GPU",
        "; ".join(found) or "none",
        f"the renderer `tiles` runs on {where}; it needs no OpenGL",
    )
    if importlib.util.find_spec("torch") is None:
        return
    import torch

    wanted = "; install a torch with CUDA to use the GPU" if found else ""
    cuda = (f"CUDA {torch.version.cuda}", "policies run on the GPU")
    yield Fact(
        "torch device",
        *(cuda if torch.cuda.is_available() else ("CPU", f"policies run on the CPU{wanted}")),
    )


def codecs() -> Iterator[Fact]:
    """Yield PyAV with the encoder that is needed, and torchcodec."""
    import av.codec

    works = CODECS["h264"] in av.codec.codecs_available
    follows = "`dynahoi generate` writes h264" if works else "only `--codec images` works"
    yield Fact(
        "PyAV",
        f"{version('av')}, writes {'h264' if works else 'no video'}",
        follows,
        problem=not works,
    )
    if importlib.util.find_spec("torchcodec") is None:
        yield Fact("torchcodec", "none", "LeRobot decodes with PyAV")
        return
    found = version("torchcodec")
    follows = "LeRobot decodes with torchcodec"
    works = True
    try:
        importlib.import_module("torchcodec")
    except (ImportError, OSError, RuntimeError):
        found = f"{found}, finds no FFmpeg libraries"
        works = False
        follows = "LeRobot prints a traceback and decodes with PyAV; install FFmpeg's libraries"
    yield Fact("torchcodec", found, follows, problem=not works)


OURS = ("dynahoi_lerobot", "lerobot_env_dynahoi", "lerobot_policy_obact")
OPTIONAL = {
    "lerobot": "training and LeRobot's commands need it: pip install '.[lerobot]', in a checkout",
    "torch": "comes with lerobot",
}
"""Optional libraries and their purpose."""


def versions() -> Iterator[Fact]:
    """Yield the versions of Python and of distributions; a requirement of ours that is not met is a
    problem.
    """
    yield Fact("Python", platform.python_version())
    unmet = unmet_requirements()
    core = ("mujoco", "mujoco-warp", "warp-lang", "gymnasium", "numpy")
    for name in dict.fromkeys(("dynahoi_lerobot", *core, *OPTIONAL, *unmet)):
        found = installed_version(name)
        remedy = unmet.get(name) or ("" if found else OPTIONAL.get(name, ""))
        yield Fact(name, found or "none", remedy, problem=name in unmet)


def unmet_requirements() -> dict[str, str]:
    """Return, by distribution, what installs a version that our distributions require."""
    unmet = {}
    for distribution in filter(installed_version, OURS):
        for wanted in map(Requirement, requires(distribution) or ()):
            if wanted.marker is not None and not wanted.marker.evaluate():
                continue
            found = installed_version(wanted.name)
            if found is None or not wanted.specifier.contains(found, prereleases=True):
                remedy = f"{distribution} needs {wanted}: pip install {str(wanted)!r}"
                unmet[wanted.name] = remedy
    return unmet


LEROBOT_PREFIXES = (
    "lerobot_env_",
    "lerobot_policy_",
    "lerobot_robot_",
    "lerobot_teleoperator_",
    "lerobot_camera_",
)
"""Names by which LeRobot finds its plugins."""


def plugins() -> Iterator[Fact]:
    """Yield the distributions that LeRobot imports as plugins, and the modules that the core
    imports.
    """
    found = {
        (dist.name, dist.version)
        for dist in distributions()
        if dist.name.startswith(LEROBOT_PREFIXES)
    }
    for name, installed in sorted(found):
        yield Fact(name, installed, "LeRobot finds it")
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            import_plugin(entry)
        follows = str(caught[0].message) if caught else ""
        yield Fact(f"plugin {entry.name}", entry.value, follows, problem=bool(caught))


PACED = Recording(Recipe(rules=Rules(image_size=64)))
PACED_EPISODES = 16
KNOWN_FRAMES_S = 677.0
KNOWN_PROCESSOR_S = 545.0
KNOWN_ELAPSED_S = 338.0
"""Where the quickstart was timed: speed of one core [frames/s]; the quickstart's processor time and
its wall time on two idle cores [s]."""


def pace() -> Iterator[Fact]:
    """Yield this machine's speed, sampling included, and the quickstart's duration estimated from
    it.
    """
    frames_s = frames_per_s()
    known_s = KNOWN_PROCESSOR_S if cores() == 1 else KNOWN_ELAPSED_S
    minutes = max(1.0, known_s * KNOWN_FRAMES_S / frames_s / 60)
    told = f"{frames_s:.0f} frames/s per core at {PACED.recipe.rules.image_size} px"
    yield Fact("pace", told, f"the quickstart takes about {minutes:.0f} min")


def frames_per_s() -> float:
    """Return the frames that one thread simulates and renders per second of processor time."""
    list(record(PACED, [0], threads=1))  # compiles the scene and, once on a machine, the renderer
    start = time.process_time()
    frames = sum(len(episode) for episode in record(PACED, range(1, 1 + PACED_EPISODES), threads=1))
    return frames / (time.process_time() - start)


REFERENCE = Path(__file__).with_suffix(".npz")
PLAYED = Recipe(rules=Rules(image_size=32), split="test")
EPISODES = 44
"""Every kind of motion twice."""
STRIDE = 10
"""Frames between the stored poses, from which differences are measured."""

Reference = dict[str, np.ndarray]
"""The expert's first ``n`` episodes of ``test``, as some machine played them.

``machine``: processor and library versions, in words. ``motions`` and ``images``: (n,) digests of
states, commands and target poses, and of all images. ``poses``: (K, 25) float32, hand state [m,
rad] and target pose [m, 1] at every tenth frame of all episodes. ``pixels``: (n, 32, 32, 3) uint8
RGB at control start.
"""


def read_reference() -> Reference:
    """Return the reference that comes with the package."""
    with np.load(REFERENCE, allow_pickle=False) as held:
        return dict(held)


def play(count: int) -> Reference:
    """Return the first ``count`` episodes as this machine plays them."""
    specs = sample_specs(PLAYED, range(count), threads=0)
    played = evaluate(
        WorldBatch(PLAYED.rules, min(count, 22)),
        EXPERTS[PLAYED.rules.capture_rule.expert](),
        specs,
        images=True,
    )
    episodes = sorted(played, key=lambda episode: episode.meta.seed)
    computing = LIBRARIES[:4]  # they compute states and pixels
    machine = ", ".join(
        [platform.machine(), *(f"{library} {version(library)}" for library in computing)]
    )
    return {
        "machine": np.array(machine),
        "motions": np.array([digest([e.state, e.action, e.target_pose_h]) for e in episodes]),
        "images": np.array([digest([e.images[EGO_VIEW]]) for e in episodes]),
        "poses": np.concatenate(
            [np.concatenate([e.state, e.target_pose_h], axis=1)[::STRIDE] for e in episodes]
        ),
        "pixels": np.stack([e.images[EGO_VIEW][e.meta.window_frames] for e in episodes]),
    }


def digest(arrays: Iterable[np.ndarray]) -> str:
    """Return 16 hexadecimal digits of the sha256 of the arrays' bytes."""
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    ).hexdigest()[:16]


def compare(found: Reference, wanted: Reference) -> Iterator[Fact]:
    """Yield how this machine's episodes differ from the reference."""
    yield Fact(
        "reference",
        f"benchmark {BENCHMARK.version}, {wanted['machine']}",
        f"here {found['machine']}",
    )
    same = found["motions"] == wanted["motions"]
    identical = _count(same)
    if same.all():
        yield Fact("motion", identical, "results agree with ours to the last digit")
    elif found["poses"].shape != wanted["poses"].shape:
        yield Fact(
            "motion", f"{identical}; some lengths differ", "results differ from ours", problem=True
        )
    else:
        off = np.abs(found["poses"] - wanted["poses"]).max(axis=0)
        palm_m = off[:PALM_DOF].max()
        target_m = off[HAND_DOF : HAND_DOF + 3].max()
        close = bool(off.max() <= TOLERANCE)
        confirmed = (
            "`dynahoi evaluate --replay` confirms results across both, with the same "
            "library versions"
        )
        differs = f"{identical}; palm off by at most {palm_m:.2g} m, target by {target_m:.2g} m"
        yield Fact(
            "motion", differs, confirmed if close else "results differ from ours", problem=not close
        )
    same = found["images"] == wanted["images"]
    identical = _count(same)
    if same.all():
        yield Fact("images", identical, "policies see identical images")
    else:
        off = np.abs(found["pixels"].astype(int) - wanted["pixels"])
        yield Fact(
            "images",
            f"{identical}; pixels off by at most {off.max()} of 255, {off.mean():.2g} on average",
        )


def _count(same: np.ndarray) -> str:
    return f"{same.sum()} of {len(same)} episodes are bit-identical to ours"


if __name__ == "__main__":  # rewrites the file on the reference machine
    arrays: dict[str, Any] = dict(play(EPISODES))
    np.savez_compressed(REFERENCE, **arrays)
