"""Can the benchmark be solved without predicting? Baselines that do not, in the simulator, beside the expert.

python benchmarks/validity.py [--episodes 220] [--control standard late] [--search 1760 --save FILE] [--json FILE]

Brackets are Wilson's 95 % intervals. --search looks for a better fixed path on that many episodes of train and prints
what it would score on as many episodes that it has not seen and on the split. --save writes it, in the format of
experts/blind_path.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from support.options import benchmark_parser, write_numbers
from support.path_search import hits_along, relative_paths, search_path

from dynahoi_lerobot.control_class import CONTROL_CLASSES
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.evaluate.intervals import wilson
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import CATEGORIES
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

BASELINES = ("hold", "blind_path", "pursuit", "constant_velocity", "constant_acceleration", "intercept")
WORLDS = 64
SEARCHED_FRAMES, WIDTH, FINENESS = 80, 64, 2
Rate = dict[str, float]


def main() -> None:
    parser = benchmark_parser(__doc__, episodes=2, control=["late"], search=4)
    parser.add_argument("--episodes", type=int, default=220)
    parser.add_argument("--split", default="test")
    parser.add_argument("--control", nargs="+", choices=list(CONTROL_CLASSES), default=["standard", "late"])
    parser.add_argument("--baselines", nargs="+", choices=EXPERTS.names(), default=list(BASELINES))
    parser.add_argument("--search", type=int, default=0, help="episodes of train to search a fixed path on; 0 for none")
    parser.add_argument("--save", type=Path, help="file for the path found")
    args = parser.parse_args()
    specs = sample_specs(Recipe(split=args.split), range(args.episodes), threads=0)
    found = search(args, specs) if args.search else {}
    tables = {control: {name: play(control, name, specs) for name in args.baselines} for control in args.control}
    write_numbers(args, classes=tables, found=found)


def play(control: str, name: str, specs: Sequence[EpisodeSpec]) -> dict[str, Rate]:
    """Play one baseline in one control class; print and return its rates, also of each category."""
    episodes = list(evaluate(WorldBatch(min(WORLDS, len(specs)), control_class=control), EXPERTS[name](), specs))
    rates = {
        "S_loc": rate([e.first_localized is not None for e in episodes]),
        "S_intercept": rate([METRICS["S_intercept"](e) == 1.0 for e in episodes]),
        "S_joint": rate([e.success for e in episodes]),
    }
    for category in CATEGORIES:
        localized = [e.first_localized is not None for e in episodes if e.meta.category == category]
        rates |= {category: rate(localized)} if localized else {}
    print(f"\n{control}, {name}")
    for label, row in rates.items():
        print(f"  {label:18s} {row['value']:5.1f} [{row['low']:5.1f}, {row['high']:5.1f}]")
    return rates


def rate(outcomes: Sequence[bool]) -> Rate:
    """Return a share and its interval [%]."""
    low, high = wilson(sum(outcomes), len(outcomes))
    return {"value": 100 * sum(outcomes) / len(outcomes), "low": 100 * low, "high": 100 * high, "n": len(outcomes)}


def search(args: argparse.Namespace, specs: Sequence[EpisodeSpec]) -> dict[str, Rate]:
    """Search a fixed path; print and return how many episodes it meets of those searched, of others, and of the split.

    Targets and palm are taken to move straight between frames; nothing is simulated.
    """
    train = sample_specs(Recipe(split="train"), range(2 * args.search), threads=0)
    searched = relative_paths(train[: args.search], SEARCHED_FRAMES)
    path = search_path(searched, CONTROL_CLASSES["standard"].palm_speed_m_s, WIDTH, FINENESS)
    others, split = (relative_paths(part, SEARCHED_FRAMES) for part in (train[args.search :], specs))
    rates = {
        label: rate(hits_along(path, targets).tolist())
        for label, targets in (("searched", searched), ("other train", others), (args.split, split))
    }
    for label, row in rates.items():
        print(f"fixed path on {label:12s} {row['value']:5.1f} [{row['low']:5.1f}, {row['high']:5.1f}]")
    if args.save:
        np.savetxt(args.save, path, fmt="%.4f", delimiter=",")
    return rates


if __name__ == "__main__":
    main()
