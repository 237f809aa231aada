"""The leaderboards of the benchmark: which results are ranked together, and the Hub's file that defines them.

The format of ``eval.yaml`` is documented at https://huggingface.co/docs/hub/eval-results. The Hub lists a checkpoint's
result on a leaderboard if it names one of these tasks.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import yaml

from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.salt import split_of
from dynahoi_lerobot.sampling.splits import seed_stream, split_seeds

EVAL_FILE = "eval.yaml"
BENCHMARK_NAME = "dynahoi-benchmark"
"""Name of the benchmark's dataset on the Hub, of which everybody may have one."""
CARD_REPO = f"USER/{BENCHMARK_NAME}"
"""What its card calls it until it is pushed."""
FRAMEWORK = "dynahoi"
"""Name of the evaluation framework; the Hub's list of frameworks must have it for results to show as verified."""
SPLITS = ("test", "ood_speed", "ood_object", "ood_motion")
ATTACH_METRICS = ("S_loc", "S_gra", "S_joint", "R_time")
TRACKS = (
    ("attach", "standard", ATTACH_METRICS),
    ("attach", "late", ATTACH_METRICS),
    ("attach", "unlimited", ATTACH_METRICS),
    ("contact", "standard", ("S_hold",)),
)
"""Capture rule, control class, and the metrics by which results are ranked."""
FREE = ("image_size", "views", "renderer")
"""Fields of a recipe in which ranked results may differ."""
DESCRIPTION = (
    "A five-fingered hand watches a moving object, predicts where to meet it and catches it: 22 kinds of motion in 8 "
    "categories, 11 objects, simulated in MuJoCo. Splits and rules are pinned as version {version}; every result comes "
    "with the log of its commands, from which all metrics can be computed again."
)


@dataclass(frozen=True)
class Leaderboard:
    """What is ranked together.

    Attributes:
        split: of the benchmark, played to its end.
        capture: capture rule.
        control_class: limits of the hand.
        metric: by which results are ranked.
    """

    split: str
    capture: str
    control_class: str
    metric: str

    @property
    def task_id(self) -> str:
        """Its name in ``eval.yaml`` and in results."""
        return f"{self.split}_{self.capture}_{self.control_class}_{self.metric}"


def leaderboards() -> list[Leaderboard]:
    """Return all of them."""
    return [
        Leaderboard(split, capture, control_class, metric)
        for split in SPLITS
        for capture, control_class, metrics in TRACKS
        for metric in metrics
    ]


def eval_yaml() -> str:
    """Return the benchmark's ``eval.yaml``."""
    content = {
        "name": f"DynaHOI {BENCHMARK.version}",
        "description": DESCRIPTION.format(version=BENCHMARK.version),
        "evaluation_framework": FRAMEWORK,
        "tasks": [{"id": board.task_id, "config": "default", "split": board.split} for board in leaderboards()],
    }
    return yaml.safe_dump(content, sort_keys=False, width=100)


def ranking_metrics(split: str, capture: str, control_class: str) -> tuple[str, ...]:
    """Return the metrics by which such results are ranked; none if they are on no leaderboard."""
    conditions = (split, capture, control_class)
    return tuple(b.metric for b in leaderboards() if (b.split, b.capture, b.control_class) == conditions)


def directions() -> dict[str, str]:
    """Return by metric which way is better."""
    return {board.metric: METRICS[board.metric].direction for board in leaderboards()}


def why_unranked(results: Results) -> str:
    """Return why a result is on no leaderboard; empty if it is on one.

    Raises:
        ResultsError: if it does not say what was played.
    """
    info = results.info
    if results.privileged:
        return f"{info.policy} sees the simulator's state"
    if info.benchmark != BENCHMARK.version:
        return f"it is of benchmark {info.benchmark}, not {BENCHMARK.version}"
    if not ranking_metrics(info.split, info.capture, results.control_class):
        return f"there is none for {info.split}, {info.capture}, {results.control_class}"
    if len(results.rows) != (wanted := len(split_seeds(info.split))):
        return f"{len(results.rows)} of the {wanted} episodes of {info.split} were played"
    changed = [name for name in changed_rules(results) if name not in FREE]
    return f"it was played with other {', '.join(changed)} than the benchmark's" if changed else ""


def changed_rules(results: Results) -> dict[str, Any]:
    """Return the fields of a result's recipe that are not the benchmark's, with their values.

    Raises:
        ResultsError: if the result does not say what was played.
        ValueError: if there is no such split, capture rule or control class.
    """
    info = results.info
    split = seed_stream(split_of(info.split))
    rules = Recipe(split=split, capture=info.capture, control_class=results.control_class)
    played = asdict(results.recipe())
    return {name: played[name] for name, value in asdict(rules).items() if played[name] != value}
