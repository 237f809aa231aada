"""Whether this machine reproduces our episodes: digests of 44 of them, and samples to measure differences.

``python -m dynahoi_lerobot.doctor.reference`` rewrites the file on the reference machine.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from tqdm import tqdm

from dynahoi_lerobot.core.conventions import EGO_VIEW, HAND_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.doctor.parts import Fact
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.fingerprint import LIBRARIES
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

REFERENCE = Path(__file__).with_suffix(".npz")
RECIPE = Recipe(split="test", image_size=32)
EPISODES = 44
"""Every kind of motion twice."""
STRIDE = 10
"""Frames between the stored poses, from which differences are measured."""
TOLERANCE = 1e-5
"""Greatest difference [m, rad] with which `dynahoi evaluate --replay` confirms results of another machine."""


@dataclass(frozen=True, eq=False)
class Reference:
    """What the expert's first ``n`` episodes of ``test`` were on some machine.

    Attributes:
        machine: processor and library versions, in words.
        motions: (n,) digests of states, commands and target poses, all frames.
        pictures: (n,) digests of all images.
        poses: (K, 25) float32, hand state [m, rad] and target pose [m, 1] at every tenth frame of all episodes.
        images: (n, 32, 32, 3) uint8 RGB at control start.
    """

    machine: str
    motions: np.ndarray
    pictures: np.ndarray
    poses: np.ndarray
    images: np.ndarray

    def write(self, path: Path = REFERENCE) -> None:
        """Write it to a file."""
        np.savez_compressed(path, **vars(self))

    @classmethod
    def read(cls, path: Path = REFERENCE) -> Reference:
        """Read it from a file."""
        with np.load(path, allow_pickle=False) as held:
            arrays = {name: held[name] for name in ("motions", "pictures", "poses", "images")}
            return cls(str(held["machine"]), **arrays)


def play(count: int = EPISODES) -> Reference:
    """Play the first ``count`` episodes on this machine."""
    specs = sample_specs(RECIPE, range(count), threads=0)
    played = evaluate(WorldBatch(RECIPE, min(count, 22)), EXPERTS[RECIPE.expert](), specs, images=True)
    shown = tqdm(played, total=count, desc="reference", unit="episode", disable=None)
    episodes = sorted(shown, key=lambda episode: episode.meta.seed)
    return Reference(
        machine=", ".join([platform.machine(), *(f"{library} {version(library)}" for library in LIBRARIES[:4])]),
        motions=np.array([_digest([e.state, e.action, e.target_pose]) for e in episodes]),
        pictures=np.array([_digest([e.images[EGO_VIEW]]) for e in episodes]),
        poses=np.concatenate([_poses(e) for e in episodes]),
        images=np.stack([e.images[EGO_VIEW][e.meta.window_frames] for e in episodes]),
    )


def compare(found: Reference | None = None, wanted: Reference | None = None) -> Iterator[Fact]:
    """Compare this machine's episodes with the reference.

    Args:
        found: this machine's episodes; played now if None.
        wanted: the reference; the packaged one if None.
    """
    wanted = wanted or Reference.read()
    found = found or play(len(wanted.motions))
    yield Fact("reference", f"benchmark {BENCHMARK.version}, {wanted.machine}", f"here {found.machine}")
    yield _motions(found, wanted)
    yield _pictures(found, wanted)


def _motions(found: Reference, wanted: Reference) -> Fact:
    told = _counted(found.motions == wanted.motions)
    if (found.motions == wanted.motions).all():
        return Fact("motion", told, "results agree with ours to the last digit")
    if found.poses.shape != wanted.poses.shape:
        return Fact("motion", f"{told}; some lengths differ", "results differ from ours", problem=True)
    off = np.abs(found.poses - wanted.poses).max(axis=0)
    told += f"; palm off by at most {off[:3].max():.2g} m, target by {off[HAND_DOF:][:3].max():.2g} m"
    close = bool(off.max() <= TOLERANCE)
    follows = (
        "`dynahoi evaluate --replay` confirms results across both, with the same library versions"
        if close
        else "results differ from ours"
    )
    return Fact("motion", told, follows, problem=not close)


def _pictures(found: Reference, wanted: Reference) -> Fact:
    told = _counted(found.pictures == wanted.pictures)
    if (found.pictures == wanted.pictures).all():
        return Fact("images", told, "policies see identical images")
    off = np.abs(found.images.astype(int) - wanted.images)
    return Fact("images", f"{told}; pixels off by at most {off.max()} of 255, {off.mean():.2g} on average")


def _counted(same: np.ndarray) -> str:
    return f"{int(same.sum())} of {len(same)} episodes are bit-identical to ours"


def _poses(episode: Episode) -> np.ndarray:
    return np.concatenate([episode.state, episode.target_pose], axis=1)[::STRIDE]


def _digest(arrays: Iterable[np.ndarray]) -> str:
    """Return 16 hexadecimal digits of the bytes."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]


if __name__ == "__main__":
    play().write()
