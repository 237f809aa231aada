"""Can the benchmark be solved without predicting? Baselines that do not, beside the expert.

    python benchmarks/validity.py
    python benchmarks/validity.py --episodes 1000 --control standard late unlimited --json FILE
    python benchmarks/validity.py --hand opposed --baselines pursuit intercept
    python benchmarks/validity.py --search 1760 --search-class unlimited --save FILE
    python benchmarks/validity.py --search 1760 --homes 8 --save FILE

They play in the simulator. Brackets are Wilson's 95 % intervals. --search looks for a better fixed
path on that many episodes of train and prints what it would score on as many episodes that it has
not seen and on the split. --homes K looks for K paths instead, one for each cluster of homes.
--save writes what was found, in the format of experts/blind_path.csv or nearest_home.csv.
"""

import argparse
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from support.fixed_paths import met_by_nearest, search_paths
from support.options import benchmark_parser, parse_options, pinned_benchmark, write_numbers

from dynahoi_lerobot.core.protocols import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.evaluate.summary import wilson
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import CATEGORIES
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

BASELINES = (
    "hold",
    "blind_path",
    "nearest_home",
    "pursuit",
    "constant_velocity",
    "constant_acceleration",
    "intercept",
)
TINY = {"episodes": 22, "control": ["late"], "baselines": ["hold"], "search": 4}
WORLDS = 64
LABELS = (*CATEGORIES, *OBJECTS.names())
Rate = dict[str, float]


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("--episodes", type=int, default=220)
    parser.add_argument("--split", default="test")
    parser.add_argument(
        "--control", nargs="+", choices=list(CONTROL_CLASSES), default=["standard", "late"]
    )
    parser.add_argument("--baselines", nargs="*", choices=EXPERTS.names(), default=list(BASELINES))
    parser.add_argument(
        "--hand", choices=HANDS.names(), default="capsule", help="that plays the baselines"
    )
    parser.add_argument(
        "--search",
        type=int,
        default=0,
        help="episodes of train to search a fixed path on; 0 for none",
    )
    parser.add_argument(
        "--search-class",
        choices=list(CONTROL_CLASSES),
        default="standard",
        help="whose speed it has",
    )
    parser.add_argument(
        "--homes", type=int, default=1, help="search a path for each of so many clusters of homes"
    )
    parser.add_argument("--save", type=Path, help="file for what was found")
    args = parse_options(parser, TINY)
    specs = sample_specs(Recipe(split=args.split), range(args.episodes), threads=0)
    found = search(args, specs) if args.search else {}
    tables = {
        control: {name: play(control, name, specs, args.hand) for name in args.baselines}
        for control in args.control
    }
    write_numbers(args, benchmark=pinned_benchmark(), classes=tables, found=found)


def rate(outcomes: Sequence[bool]) -> Rate:
    """Return a share and its interval [%]."""
    low, high = wilson(sum(outcomes), len(outcomes))
    share = sum(outcomes) / len(outcomes)
    return {"value": 100 * share, "low": 100 * low, "high": 100 * high, "n": len(outcomes)}


def shown(row: Rate) -> str:
    """Return a rate as people read it."""
    return "{value:5.1f} [{low:5.1f}, {high:5.1f}]".format(**row)


def play(control: str, name: str, specs: Sequence[EpisodeSpec], hand: str) -> dict[str, Rate]:
    """Play one baseline in one control class; print and return its rates, also of each category and
    object.
    """
    batch = WorldBatch(Rules(control_class=control, hand=hand), min(WORLDS, len(specs)))
    episodes = list(evaluate(batch, EXPERTS[name](), specs))
    localized = [episode.first_localized is not None for episode in episodes]
    rates = {
        "S_loc": rate(localized),
        "S_intercept": rate([METRICS["S_intercept"](episode) == 1.0 for episode in episodes]),
        "S_joint": rate([episode.success for episode in episodes]),
    }
    by_label = defaultdict(list)
    for episode, outcome in zip(episodes, localized, strict=True):
        by_label[episode.meta.category].append(outcome)
        by_label[episode.meta.object].append(outcome)
    rates |= {label: rate(by_label[label]) for label in LABELS if label in by_label}
    print(f"\n{control}, {name}")
    for label, row in rates.items():
        print(f"  {label:18s} {shown(row)}")
    return rates


def search(args: argparse.Namespace, specs: Sequence[EpisodeSpec]) -> dict[str, Rate]:
    """Search fixed paths; print and return how many episodes they meet of those searched, of
    others, and of the split.
    """
    train = sample_specs(Recipe(split="train"), range(2 * args.search), threads=0)
    parts = {
        "searched": train[: args.search],
        "other train": train[args.search :],
        args.split: specs,
    }
    speed_m_s = CONTROL_CLASSES[args.search_class].palm_speed_m_s
    centers, paths = search_paths(parts["searched"], args.homes, speed_m_s)
    rates = {
        label: rate(met_by_nearest(part, centers, paths).tolist()) for label, part in parts.items()
    }
    for label, row in rates.items():
        print(f"fixed path on {label:12s} {shown(row)}")
    if args.save:
        rows = paths[0] if args.homes == 1 else np.hstack([centers, paths.reshape(len(paths), -1)])
        np.savetxt(args.save, rows, fmt="%.4f", delimiter=",")
    return rates


if __name__ == "__main__":
    main()
