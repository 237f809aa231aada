"""Do numbers and words give the meeting point away? A regressor on what a policy sees but pictures.

python benchmarks/sightless.py [--train 1760] [--episodes 1000] [--split test] [--json FILE]

The regressor is given what policies observe, in the home frame, and, to show what that frame hides, the home's position
in the world as well. R2 is the share of the variance of the meeting point (x, y, z) and time that it explains on
episodes that it has not seen. S_loc is that of a hand that goes there straight at the standard limit, and waits. Paths
by motion are the best fixed paths of each kind, for the episodes whose instruction names the kind. Nothing is simulated
but the first observations; targets and palm move straight between frames. Brackets are Wilson's 95 % intervals.
"""

import numpy as np
from support.home_clusters import homes_of
from support.options import benchmark_parser, write_numbers
from support.path_search import hits_along, relative_paths, search_path
from support.sightless import fit, hits_at, meetings, numbers_seen, predict, vocabulary_of, words_seen

from dynahoi_lerobot.core.rules import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.evaluate.summary import wilson
from dynahoi_lerobot.experts.baselines import fixed_path
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

SPEED_M_S = CONTROL_CLASSES["standard"].palm_speed_m_s
FRAMES, WIDTH, FINENESS = 80, 64, 2
Row = dict[str, float | list[float]]


def main() -> None:
    parser = benchmark_parser(__doc__, train=44, episodes=22)
    parser.add_argument("--train", type=int, default=1760, help="episodes of train that the regressor learns from")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--split", default="test")
    args = parser.parse_args()
    train = sample_specs(Recipe(split="train"), range(args.train), threads=0)
    split = sample_specs(Recipe(split=args.split), range(args.episodes), threads=0)
    targets = relative_paths(split, FRAMES)
    table = {f"regressor, {name}": regression(*inputs, train, split) for name, inputs in variants(train, split).items()}
    table["blind_path"] = rate(hits_along(fixed_path("standard"), targets))
    table["blind_path, unlimited"] = rate(hits_along(fixed_path("unlimited"), targets))
    table["paths by motion"] = rate(paths_by_motion(train, split))
    for name, row in table.items():
        told = f"  R2 {np.round(row['R2'], 2)}" if "R2" in row else ""
        print(f"{name:34s} S_loc {row['value']:5.1f} [{row['low']:5.1f}, {row['high']:5.1f}]{told}")
    write_numbers(args, table=table)


def variants(train: list[EpisodeSpec], split: list[EpisodeSpec]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the inputs of each regressor, (N, D) of training and of the split."""
    vocabulary = vocabulary_of(train)
    numbers, words, homes = (
        (part(train), part(split)) for part in (numbers_seen, lambda s: words_seen(s, vocabulary), homes_of)
    )
    chosen = {
        "numbers": (numbers,),
        "numbers and words": (numbers, words),
        "numbers and home": (numbers, homes),
        "numbers, words and home": (numbers, words, homes),
    }
    return {
        name: (np.hstack([p[0] for p in parts]), np.hstack([p[1] for p in parts])) for name, parts in chosen.items()
    }


def regression(seen: np.ndarray, asked: np.ndarray, train: list[EpisodeSpec], split: list[EpisodeSpec]) -> Row:
    """Train on (N, D) inputs ``seen``; return what is explained and met of those of the split, (M, D) ``asked``."""
    predicted, true = predict(fit(seen, meetings(train)), asked), meetings(split)
    explained = 1 - ((predicted - true) ** 2).sum(axis=0) / ((true - true.mean(axis=0)) ** 2).sum(axis=0)
    return {**rate(hits_at(predicted, relative_paths(split, FRAMES), SPEED_M_S)), "R2": explained.tolist()}


def paths_by_motion(train: list[EpisodeSpec], split: list[EpisodeSpec]) -> np.ndarray:
    """Return (M,) bool: what the best path of its kind meets, or the fixed path where no instruction names the kind."""
    targets, searched = relative_paths(split, FRAMES), relative_paths(train, FRAMES)
    met = hits_along(fixed_path("standard"), targets)
    kinds = np.array([spec.motion.name for spec in train])
    for kind in sorted(set(kinds)):
        path = search_path(searched[kinds == kind], SPEED_M_S, WIDTH, FINENESS)
        told = np.array([spec.motion.name == kind and spec.motion.phrase in spec.task for spec in split])
        met[told] = hits_along(path, targets[told])
    return met


def rate(outcomes: np.ndarray) -> Row:
    """Return a share and its interval [%]."""
    low, high = wilson(int(outcomes.sum()), len(outcomes))
    return {"value": 100 * float(outcomes.mean()), "low": 100 * low, "high": 100 * high}


if __name__ == "__main__":
    main()
