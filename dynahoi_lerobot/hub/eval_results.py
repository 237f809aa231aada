"""Evaluation results as the Hub reads them: ``.eval_results/*.yaml`` beside a checkpoint.

The format is documented at https://huggingface.co/docs/hub/eval-results. The Hub shows the values on the checkpoint's
page and on the leaderboard of the benchmark's dataset.
"""

from __future__ import annotations

import hashlib
import re
from typing import Any

import yaml

from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.hub.leaderboards import Leaderboard, changed_rules, ranking_metrics
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.salt import split_of

EVAL_RESULTS = ".eval_results"
NAME_LENGTH = 120
"""Characters of the longest name; a longer one is cut and ends with a hash."""
DIGITS = 8


def variant(results: Results) -> str:
    """Return a file name for the conditions of an evaluation; others have another one, as the Hub asks.

    It says the rules, whatever of the recipe is not the benchmark's, and the number of episodes of a part of a split.

    Raises:
        ResultsError: if the results do not say what was played.
        ValueError: if there is no such split, capture rule or control class.
    """
    info = results.info
    words = [info.benchmark, info.split, info.capture, results.control_class]
    words += [_text(info.extra[name]) for name in ("inference", "settings") if info.extra.get(name)]
    words += [f"{name}_{_text(value)}" for name, value in changed_rules(results).items() if name != "salt"]
    text = "_".join([*words, *_part(results)])
    name = re.sub(r"[^A-Za-z0-9.-]+", "_", text).strip("_.")
    return name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - DIGITS - 1]}_{_digest(text)}"


def _part(results: Results) -> list[str]:
    """Return how many episodes were played and, if they are not the first ones, which; nothing for a whole split."""
    seeds = sorted(row["seed"] for row in results.rows)
    if len(seeds) == BENCHMARK.splits[split_of(results.info.split)].size:
        return []
    first = seeds == list(range(len(seeds)))
    return [f"{len(seeds)}_episodes", *([] if first else [_digest(str(seeds))])]


def _text(value: Any) -> str:
    return "_".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def eval_results_yaml(results: Results, benchmark: str, source: str) -> str:
    """Return one entry per metric by which such results are ranked and that any episode meets the condition of.

    Args:
        results: an evaluation.
        benchmark: the dataset's repository whose leaderboard lists them; its ``eval.yaml`` defines the tasks.
        source: address of the result folder.
    """
    info, summary = results.info, results.summary()
    boards = [
        Leaderboard(info.split, info.capture, results.control_class, name)
        for name in ranking_metrics(info.split, info.capture, results.control_class)
    ]
    entries = [
        _entry(results, board, summary[board.metric], benchmark)
        | {"source": {"url": source, "name": "Metrics and action log"}}
        for board in boards
        if summary[board.metric].value is not None
    ]
    return yaml.safe_dump(entries, sort_keys=False)


def _entry(results: Results, board: Leaderboard, estimate: Estimate, benchmark: str) -> dict[str, Any]:
    info, conditions = results.info, results.info.conditions
    notes = (
        f"unit {estimate.unit}, 95 % interval [{estimate.low:.4g}, {estimate.high:.4g}], {estimate.n} episodes of "
        f"{info.split}, capture rule {info.capture}, control class {results.control_class}, "
        f"inference {conditions['inference']}, settings {conditions['settings']}, benchmark {info.benchmark}"
    )
    return {"dataset": {"id": benchmark, "task_id": board.task_id}, "value": estimate.value, "notes": notes}
