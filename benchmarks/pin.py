"""Pin the benchmark: its digests, and the attempts at which its episodes' draws fit; or compare.

    python benchmarks/pin.py
    python benchmarks/pin.py --check
    python benchmarks/pin.py --check --seeds 22 --json FILE

``--digests`` (tests/sampling/benchmark_digests.json) holds digests of the definition
(`sampling/benchmark.py`), of the specs of every seed of all splits (of ``train`` the first 220),
and of images of the default renderer at 64 px. A digest that changes is a new benchmark version.
``--entries`` (dynahoi_lerobot/sampling/accepted.npz) holds the accepted attempt of every seed of
the splits of fixed size. Every seed is searched from its first attempt.
"""

import hashlib
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np
from support.options import PINNED, benchmark_parser, parse_options, write_numbers

from dynahoi_lerobot.core.agent import Expert, WorldView
from dynahoi_lerobot.core.conventions import PALM_DOF
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.accepted import ENTRIES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs, search
from dynahoi_lerobot.world.batch import WorldBatch

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
TINY = {
    "digests": Path("digests.json"),
    "entries": Path("accepted.npz"),
    "seeds": 2,
    "with_images": 1,
}

Pinned = dict[str, Any]
"""``version`` and ``definition``; digests of ``specs`` by split and seed, and of ``images`` by
``split/seed``; ``attempts`` by split and seed, and ``entries_of``, the benchmark of theirs."""


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
    parser.add_argument("--digests", type=Path, default=PINNED)
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
    found = pin(args.seeds, args.with_images)
    episodes = sum(map(len, found["specs"].values()))
    write_numbers(args, specs=episodes, images=len(found["images"]))
    if args.check:
        sentences = differences(found, read(args.digests, args.entries))
        print("\n".join(sentences) or f"{args.digests} and {args.entries}: nothing differs")
        return bool(sentences)
    write(found, args.digests, args.entries)
    print(f"{args.digests} and {args.entries}: {found['entries_of']}, {episodes} episodes")
    print(f"EPISODES_DIGEST in dynahoi_lerobot/sampling/benchmark.py: {digest_of(found)}")
    return 0


def pin(seeds: int | None = None, with_images: int = IMAGE_EPISODES) -> Pinned:
    """Return all that is pinned; of the first ``seeds`` of each split only if that is given."""
    specs = {}
    attempts = {}
    images: dict[str, str] = {}
    for split in BENCHMARK.streams:
        accepted = search(Recipe(split=split), pinned_seeds(split)[:seeds], threads=0)
        specs[split] = {spec.seed: spec_digest(spec) for _, spec in accepted}
        if BENCHMARK.splits[split].size:
            attempts[split] = {candidate.seed: candidate.attempts for candidate, _ in accepted}
        images |= image_digests(split, with_images)
    pinned = {"version": BENCHMARK.version, "definition": definition()}
    pinned |= {"specs": specs, "images": images, "attempts": attempts}
    return pinned | {"entries_of": benchmark_id(pinned)}


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
    batch = WorldBatch(recipe.rules, batch_size, threads)
    digests = {}
    for episode in evaluate(batch, Closing(), specs, images=True):
        pixels = episode.images["ego"][::IMAGE_STRIDE]
        digest = hashlib.sha256(pixels.tobytes()).hexdigest()
        digests[f"{split}/{episode.meta.seed}"] = digest[:16]
    return dict(sorted(digests.items()))


def read(digests: Path = PINNED, entries: Path = ENTRIES) -> Pinned:
    """Return what the two files pin."""
    pinned = json.loads(digests.read_text())
    specs = {
        split: dict(enumerate(" ".join(lines).split())) for split, lines in pinned["specs"].items()
    }
    with np.load(entries) as stored:
        arrays = dict(stored)
    entries_of = str(arrays.pop("benchmark"))
    attempts = {split: dict(enumerate(array.tolist())) for split, array in arrays.items()}
    return pinned | {"specs": specs, "attempts": attempts, "entries_of": entries_of}


def write(pinned: Pinned, digests: Path, entries: Path) -> None:
    """Write the two files; the digests of specs, whose seeds count from 0, in lines."""
    specs = {
        split: [" ".join(line) for line in batched(by_seed.values(), ACROSS)]
        for split, by_seed in pinned["specs"].items()
    }
    content = {name: pinned[name] for name in ("version", "definition")}
    content |= {"specs": specs, "images": pinned["images"]}
    digests.write_text(json.dumps(content, indent=1) + "\n")
    attempts = {
        split: np.array([*by_seed.values()], np.uint16)
        for split, by_seed in pinned["attempts"].items()
    }
    identity = np.array(pinned["entries_of"])
    np.savez_compressed(entries, benchmark=identity, **attempts)  # type: ignore[arg-type]


def differences(found: Pinned, wanted: Pinned) -> list[str]:
    """Return a sentence for everything in ``found`` that is pinned otherwise, or not at all, and if
    the attempts that are pinned are those of another benchmark than the digests.
    """
    sentences = [
        f"{name} is {found[name]!r}; pinned is {wanted[name]!r}"
        for name in ("version", "definition")
        if found[name] != wanted[name]
    ]
    if wanted["entries_of"] != benchmark_id(wanted):
        sentences.append(
            f"attempts are pinned for {wanted['entries_of']!r}, digests for "
            f"{benchmark_id(wanted)!r}"
        )
    for part in ("specs", "attempts"):
        for split, values in found[part].items():
            sentences += _differing(f"{part} of {split}", values, wanted[part].get(split, {}))
    return sentences + _differing("images", found["images"], wanted["images"])


def _differing(noun: str, found: Mapping[Any, Any], wanted: Mapping[Any, Any]) -> list[str]:
    keys = [key for key, value in found.items() if wanted.get(key) != value]
    return [f"{len(keys)} of {len(found)} {noun} differ, the first is {keys[0]}"] if keys else []


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
