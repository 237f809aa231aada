"""Evaluation results as the Hub reads them: ``.eval_results/*.yaml`` beside a checkpoint.

The format is documented at https://huggingface.co/docs/hub/eval-results. The Hub shows the values on the checkpoint's
page and on the leaderboard of the benchmark's dataset.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from dynahoi_lerobot.evaluate.results import Results
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.hub.leaderboards import Leaderboard, ranking_metrics

EVAL_RESULTS = ".eval_results"


def variant(results: Results) -> str:
    """Return a file name for the conditions of an evaluation; others have another one, as the Hub asks."""
    info = results.info
    words = [info.split, info.capture, results.control_class]
    words += [str(info.extra[name]) for name in ("inference", "settings") if info.extra.get(name)]
    return re.sub(r"[^A-Za-z0-9.]+", "_", "_".join(words)).strip("_.")


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
