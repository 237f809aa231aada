"""Write dynahoi_lerobot/sampling/accepted.npz: where the draws of the benchmark's episodes
succeeded; or compare with it.

python benchmarks/accept.py [--check] [--out dynahoi_lerobot/sampling/accepted.npz] [--json FILE]

Every seed of the splits of fixed size is searched from its first draw. To be repeated after
`benchmarks/pin.py` has pinned another ``EPISODES_DIGEST``.
"""

import sys
from itertools import batched
from pathlib import Path

import numpy as np
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.sampling.accepted import ENTRIES, ENTRY, checksum_of, entry_of
from dynahoi_lerobot.sampling.benchmark import BENCHMARK, BENCHMARK_ID
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import resume, search
from dynahoi_lerobot.sampling.splits import split_seeds

TINY = {"out": Path("accepted.npz"), "seeds": 2}
AT_ONCE = 110
"""Seeds whose targets are rolled ahead together."""


def main() -> int:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--out", type=Path, default=ENTRIES)
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; compare with the file and exit 1 if it differs",
    )
    parser.add_argument("--seeds", type=int, help="no more than the first seeds of each split")
    args = parser.parse_args()
    streams = [name for name in BENCHMARK.streams if BENCHMARK.splits[name].size]
    found = {name: entries(name, split_seeds(name)[: args.seeds]) for name in streams}
    write_numbers(args, episodes=sum(map(len, found.values())))
    if args.check:
        differing = differences(found, args.out)
        print("\n".join(differing) or f"{args.out}: nothing differs")
        return bool(differing)
    np.savez_compressed(args.out, benchmark=np.array(BENCHMARK_ID), **found)  # type: ignore[arg-type]
    print(f"{args.out}: {sum(map(len, found.values()))} episodes of {BENCHMARK_ID}")
    return 0


def entries(split: str, seeds: range) -> np.ndarray:
    """Return (K,) `ENTRY` of seeds of a split, searched from their first draws."""
    recipe = Recipe(split=split)
    return np.array(
        [entry for some in batched(seeds, AT_ONCE) for entry in _entries(recipe, some)],
        ENTRY,
    )


def _entries(recipe: Recipe, seeds: tuple[int, ...]) -> list[np.void]:
    found = search(recipe, seeds, threads=0)
    starts = [entry_of(c.start, c.timing, home=0, checksum=0) for c, _ in found]
    resumed = resume(recipe, list(zip(seeds, starts, strict=True)), threads=0)
    made = []
    for (candidate, spec), (again, paths_w, homes) in zip(found, resumed, strict=True):
        (home, *_) = np.flatnonzero((homes == spec.home_pos_w).all(axis=1))
        checksum = checksum_of(paths_w, spec.home_pos_w, again.target)
        made.append(entry_of(candidate.start, candidate.timing, int(home), checksum))
    return made


def differences(found: dict[str, np.ndarray], path: Path) -> list[str]:
    """Return a sentence for every split of which a file says something else."""
    with np.load(path) as stored:
        sentences = [
            f"benchmark is {BENCHMARK_ID!r}; the file's is {name!r}"
            for name in [str(stored["benchmark"])]
            if name != BENCHMARK_ID
        ]
        for name, wanted in found.items():
            differing = np.flatnonzero(wanted != stored[name][: len(wanted)])
            if len(differing):
                sentences.append(
                    f"{len(differing)} of {len(wanted)} entries of {name} differ, the first is "
                    f"{differing[0]}"
                )
    return sentences


if __name__ == "__main__":
    sys.exit(main())
