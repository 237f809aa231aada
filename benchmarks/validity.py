"""Can the benchmark be solved without predicting? Baselines that do not, in the simulator, beside
the expert.

python benchmarks/validity.py [--episodes 220] [--control standard late] [--hand opposed] [--json
FILE] python benchmarks/validity.py --episodes 1000 --control standard late unlimited --json
docs/figures/baselines.json python benchmarks/validity.py --search 1760 [--search-class unlimited]
[--homes 8] [--save FILE]

Brackets are Wilson's 95 % intervals. --search looks for a better fixed path on that many episodes
of train and prints what it would score on as many episodes that it has not seen and on the split.
--homes K looks for K paths instead, one for each cluster of homes. --save writes what was found, in
the format of experts/blind_path.csv or nearest_home.csv.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from support.fixed_paths import (
    cluster,
    hits_by_cluster,
    homes_of,
    nearest,
    relative_paths,
    search_path,
)
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
FRAMES, WIDTH, FINENESS = 80, 64, 2
"""Of the paths that are searched: length, and see ``search_path``."""
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


def play(control: str, name: str, specs: Sequence[EpisodeSpec], hand: str) -> dict[str, Rate]:
    """Play one baseline in one control class; print and return its rates, also of each category and
    object.
    """
    batch = WorldBatch(Rules(control_class=control, hand=hand), min(WORLDS, len(specs)))
    episodes = list(evaluate(batch, EXPERTS[name](), specs))
    rates = {
        "S_loc": rate([e.first_localized is not None for e in episodes]),
        "S_intercept": rate([METRICS["S_intercept"](e) == 1.0 for e in episodes]),
        "S_joint": rate([e.success for e in episodes]),
    }
    for label in (*CATEGORIES, *OBJECTS.names()):
        localized = [
            e.first_localized is not None
            for e in episodes
            if label in (e.meta.category, e.meta.object)
        ]
        rates |= {label: rate(localized)} if localized else {}
    print(f"\n{control}, {name}")
    for label, row in rates.items():
        print(f"  {label:18s} {row['value']:5.1f} [{row['low']:5.1f}, {row['high']:5.1f}]")
    return rates


def search(args: argparse.Namespace, specs: Sequence[EpisodeSpec]) -> dict[str, Rate]:
    """Search fixed paths; print and return how many episodes they meet of those searched, of
    others, and of the split.

    Targets and palm are taken to move straight between frames; nothing is simulated.
    """
    train = sample_specs(Recipe(split="train"), range(2 * args.search), threads=0)
    parts = {
        "searched": train[: args.search],
        "other train": train[args.search :],
        args.split: specs,
    }
    speed_m_s = CONTROL_CLASSES[args.search_class].palm_speed_m_s
    table = search_paths(parts["searched"], args.homes, speed_m_s)
    rates = {}
    for label, part in parts.items():
        met = hits_by_cluster(homes_of(part), relative_paths(part, FRAMES), table)
        rates[label] = rate(met.tolist())
        print(
            "fixed path on {:12s} {value:5.1f} [{low:5.1f}, {high:5.1f}]".format(
                label, **rates[label]
            )
        )
    if args.save:
        centers, paths = table
        rows = paths[0] if args.homes == 1 else np.hstack([centers, paths.reshape(len(paths), -1)])
        np.savetxt(args.save, rows, fmt="%.4f", delimiter=",")
    return rates


def search_paths(
    specs: Sequence[EpisodeSpec], clusters: int, speed_m_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, 3) the centers of clusters of homes [m], world, and (C, K, 3) the path found for
    each.
    """
    targets = relative_paths(specs, FRAMES)
    homes_w = homes_of(specs)
    centers = cluster(homes_w, clusters)
    labels = nearest(homes_w, centers)
    return centers, np.stack(
        [search_path(targets[labels == k], speed_m_s, WIDTH, FINENESS) for k in range(clusters)]
    )


if __name__ == "__main__":
    main()
