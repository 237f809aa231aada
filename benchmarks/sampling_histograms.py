"""Do sampled episodes reproduce the paper's histograms of duration and hand travel (Figure 3 c-d)?

python benchmarks/sampling_histograms.py [--episodes 10000] [--split train] [--json FILE]

Prints the share of full episode specs in each bin beside the paper's; the paper leaves 10 % of travels unassigned.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from support.options import benchmark_parser, write_numbers
from tqdm import tqdm

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import UNIT_M
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

PAPER_TRAVEL_SHARES = (0.201, 0.477, 0.164, 0.058)
BLOCK = 220
Table = list[dict[str, float | str]]


def main() -> None:
    parser = benchmark_parser(__doc__, episodes=22)
    parser.add_argument("--episodes", type=int, default=10_000)
    parser.add_argument("--split", default="train")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    lengths, travels = [], []
    for spec in tqdm(_specs(Recipe(split=args.split), args.episodes, args.threads), total=args.episodes, mininterval=5):
        lengths.append(spec.length_frames)
        travels.append(spec.travel_m)
    durations, travel_edges_u = BENCHMARK.durations, np.array(BENCHMARK.travels.edges) / UNIT_M
    tables = {
        "duration [frames]": table(np.array(lengths), durations.edges, durations.shares),
        "travel [u]": table(np.array(travels) / UNIT_M, travel_edges_u, PAPER_TRAVEL_SHARES),
    }
    for name, rows in tables.items():
        print(f"\n{name:18s} paper %   here %  difference")
        for row in rows:
            print(f"{row['bin']:18s} {row['paper']:7.1f} {row['here']:8.1f} {row['here'] - row['paper']:+11.1f}")
    write_numbers(args, **tables)


def table(values: np.ndarray, edges: np.ndarray | tuple[float, ...], paper: tuple[float, ...]) -> Table:
    """Return one row per bin: its bounds, the paper's share and ours [%]."""
    counts = np.histogram(values, edges)[0]
    return [
        {"bin": f"{low:g} to {high:g}", "paper": 100 * share, "here": 100 * count / len(values)}
        for low, high, share, count in zip(edges[:-1], edges[1:], paper, counts, strict=True)
    ]


def _specs(recipe: Recipe, count: int, threads: int) -> Iterator[EpisodeSpec]:
    for first in range(0, count, BLOCK):
        yield from sample_specs(recipe, range(first, min(first + BLOCK, count)), threads=threads)


if __name__ == "__main__":
    main()
