"""Pin the benchmark: its digests, and the attempts at which its episodes' draws fit; or compare.

python benchmarks/pin.py [--check] [--json FILE]

``--digests`` (tests/sampling/benchmark_digests.json) holds digests of the definition
(`sampling/benchmark.py`), of the specs of every seed of all splits (of ``train`` the first 220),
and of images of the default renderer at 64 px. A digest that changes is a new benchmark version.
``--entries`` (dynahoi_lerobot/sampling/accepted.npz) holds the accepted attempt of every seed of
the splits of fixed size. Every seed is searched from its first attempt.
"""

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np
from support.options import benchmark_parser, parse_options, write_numbers

from dynahoi_lerobot.core.agent import Expert, WorldView
from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.accepted import ENTRIES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import Candidate, sample_specs, search
from dynahoi_lerobot.world.batch import WorldBatch

DIGESTS = Path(__file__).parents[1] / "tests" / "sampling" / "benchmark_digests.json"
TRAIN_SEEDS = 220
"""How many seeds of the endless split are pinned."""
IMAGE_EPISODES = 4
"""Of each split, at seeds of its own, so that all of them together have every kind of motion."""
IMAGE_PX = 64
IMAGE_STRIDE = 5
DECIMALS = 6
"""Lengths [m], times [s] and angles [rad] are pinned to a millionth, so that compilers may round
differently."""
ACROSS = 11
"""Digests in a line of the file."""
AT_ONCE = 110
"""Seeds whose targets are rolled ahead together."""
TINY = {
    "digests": Path("digests.json"),
    "entries": Path("accepted.npz"),
    "seeds": 2,
    "with_images": 1,
}

Pinned = dict[str, Any]
"""``version`` and ``definition``; ``specs`` and ``images`` by split and seed."""


class Closing(Expert):
    """Moves forwards at 0.1 m/s and closes over 30 frames, whatever the target does; it changes
    with no expert.
    """

    name = "closing"

    def command(self, world: WorldView) -> np.ndarray:
        """Return (18,) the command of one world."""
        palm = world.state[:PALM_DOF]
        joints = world.state[PALM_DOF:]
        return np.concatenate([palm + [0.005, 0.0, 0.0], np.minimum(joints + 0.05, 1.5)])


def main() -> int:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--digests", type=Path, default=DIGESTS)
    parser.add_argument("--entries", type=Path, default=ENTRIES)
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; compare with the files and exit 1 if they differ",
    )
    parser.add_argument("--seeds", type=int, help="pin no more than the first seeds of each split")
    parser.add_argument(
        "--with-images", type=int, default=IMAGE_EPISODES, help="episodes of each split with images"
    )
    args = parse_options(parser, TINY)
    pinned, attempts = pin(args.seeds, args.with_images)
    episodes = sum(map(len, pinned["specs"].values()))
    write_numbers(args, specs=episodes, images=len(pinned["images"]))
    if args.check:
        wanted = read(args.digests)
        sentences = differences(pinned, wanted)
        sentences += attempt_differences(attempts, benchmark_id(wanted), args.entries)
        print("\n".join(sentences) or f"{args.digests} and {args.entries}: nothing differs")
        return bool(sentences)
    args.digests.write_text(json.dumps(_in_lines(pinned), indent=1) + "\n")
    identity = np.array(benchmark_id(pinned))
    np.savez_compressed(args.entries, benchmark=identity, **attempts)  # type: ignore[arg-type]
    print(f"{args.digests} and {args.entries}: {identity}, {episodes} episodes")
    print(f"EPISODES_DIGEST in dynahoi_lerobot/sampling/benchmark.py: {digest_of(pinned)}")
    return 0


def pin(
    seeds: int | None = None, with_images: int = IMAGE_EPISODES
) -> tuple[Pinned, dict[str, np.ndarray]]:
    """Return all digests, and the accepted attempts of the splits of fixed size; of the first
    ``seeds`` of each split only if that is given.
    """
    specs = {}
    attempts = {}
    images: dict[str, str] = {}
    for split in BENCHMARK.streams:
        accepted = searched(split, pinned_seeds(split)[:seeds])
        specs[split] = {spec.seed: spec_digest(spec) for _, spec in accepted}
        if BENCHMARK.splits[split].size:
            attempts[split] = np.array([candidate.attempts for candidate, _ in accepted], np.uint16)
        images |= image_digests(split, with_images)
    pinned = {"version": BENCHMARK.version, "definition": definition()}
    return pinned | {"specs": specs, "images": images}, attempts


def definition() -> str:
    """Return the digest of everything that `sampling/benchmark.py` says."""
    return _digest(asdict(BENCHMARK))[:16]


def digest_of(pinned: Pinned) -> str:
    """Return the digest of all digests: ``EPISODES_DIGEST`` of `sampling/benchmark.py`."""
    return _digest({name: pinned[name] for name in ("definition", "specs", "images")})[:8]


def pinned_seeds(split: str) -> range:
    """Return the seeds of a split whose specs are pinned."""
    return range(BENCHMARK.splits[split].size or TRAIN_SEEDS)


def benchmark_id(pinned: Pinned) -> str:
    """Return the ``BENCHMARK_ID`` of `sampling/benchmark.py` that digests lead to."""
    return f"{pinned['version']}-{digest_of(pinned)}"


def searched(
    split: str, seeds: Sequence[int], *, threads: int = 0
) -> list[tuple[Candidate, EpisodeSpec]]:
    """Return the accepted candidate and the spec of each seed, searched from its first draw."""
    recipe = Recipe(split=split)
    return [
        one for some in batched(seeds, AT_ONCE) for one in search(recipe, some, threads=threads)
    ]


def spec_digest(spec: EpisodeSpec) -> str:
    """Return a digest of all that a spec holds but its code."""
    return _digest(_content(spec))[:8]


def image_digests(
    split: str, count: int = IMAGE_EPISODES, *, batch_size: int = 4, threads: int = 0
) -> dict[str, str]:
    """Return a digest of the images of the first of ``IMAGE_EPISODES`` episodes, by ``split/seed``.

    Of every fifth frame in which a hand moves forwards and closes, from the hand's camera, 64 px.
    """
    recipe = Recipe.of(split=split, image_size=IMAGE_PX)
    first = IMAGE_EPISODES * BENCHMARK.streams.index(split)
    specs = sample_specs(recipe, range(first, first + count), threads=threads)
    episodes = evaluate(
        WorldBatch(recipe.rules, batch_size, threads), Closing(), specs, images=True
    )
    pixels = {
        f"{split}/{episode.meta.seed}": episode.images["ego"][::IMAGE_STRIDE]
        for episode in episodes
    }
    return {
        name: hashlib.sha256(pixels[name].tobytes()).hexdigest()[:16] for name in sorted(pixels)
    }


def read(path: Path = DIGESTS) -> Pinned:
    """Return the digests of a file."""
    pinned = json.loads(path.read_text())
    specs = {
        split: dict(enumerate(" ".join(lines).split())) for split, lines in pinned["specs"].items()
    }
    return pinned | {"specs": specs}


def differences(found: Pinned, wanted: Pinned) -> list[str]:
    """Return a sentence for everything in ``found`` that is pinned otherwise, or not at all."""
    sentences = [
        f"{name} is {found[name]!r}; pinned is {wanted[name]!r}"
        for name in ("version", "definition")
        if found[name] != wanted[name]
    ]
    for split, digests in found["specs"].items():
        sentences += _differing(f"specs of {split}", digests, wanted["specs"].get(split, {}))
    return sentences + _differing("images", found["images"], wanted["images"])


def attempt_differences(attempts: dict[str, np.ndarray], identity: str, path: Path) -> list[str]:
    """Return a sentence for every split whose attempts a file has otherwise, and for another
    benchmark.
    """
    with np.load(path) as stored:
        name = str(stored["benchmark"])
        sentences = [] if name == identity else [f"benchmark is {identity!r}; {path} has {name!r}"]
        for split, rows in attempts.items():
            pairs = (dict(enumerate(some.tolist())) for some in (rows, stored[split]))
            sentences += _differing(f"attempts of {split}", *pairs)
    return sentences


def _differing(noun: str, found: Mapping[Any, Any], wanted: Mapping[Any, Any]) -> list[str]:
    keys = [str(key) for key, digest in found.items() if wanted.get(key) != digest]
    return [f"{len(keys)} of {len(found)} {noun} differ, the first is {keys[0]}"] if keys else []


def _in_lines(pinned: Pinned) -> Pinned:
    """Join the digests of specs, whose seeds count from 0, to lines."""
    specs = {
        split: [
            " ".join(list(digests.values())[i : i + ACROSS]) for i in range(0, len(digests), ACROSS)
        ]
        for split, digests in pinned["specs"].items()
    }
    return pinned | {"specs": specs}


def _content(spec: EpisodeSpec) -> dict[str, Any]:
    motion = [spec.motion.name, spec.motion.parameters()]
    apart = ("open_joints", "reference_joints", "target_path_w", "code")
    drawn = {name: value for name, value in vars(spec).items() if name not in apart}
    return {**drawn, "motion": motion, "oracle_path": spec.target_path_w, "fingerprint": ""}


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(_rounded(value), sort_keys=True).encode()).hexdigest()


def _rounded(value: Any) -> Any:
    if isinstance(value, str):
        return _rounded(json.loads(value)) if value.startswith("{") else value
    if isinstance(value, float | np.floating):
        return round(float(value), DECIMALS) + 0.0  # no negative zero
    if isinstance(value, np.ndarray):
        return _rounded(value.tolist())
    if isinstance(value, dict):
        return {
            key: _rounded(entry) for key, entry in value.items() if entry is not None
        }  # parts that it lacks
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return _rounded(vars(value)) if hasattr(value, "__dict__") else value


if __name__ == "__main__":
    sys.exit(main())
