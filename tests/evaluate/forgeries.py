"""Forged results, by what is done to the folder of honest ones."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dynahoi_lerobot.evaluate import result_files
from dynahoi_lerobot.evaluate.results import Results, ResultsRecorder, read_results
from dynahoi_lerobot.rollout.replay import replay


def rewritten(folder: Path, **changes: object) -> None:
    """Write results again with other contents, its sums made to fit."""
    results: Results = replace(read_results(folder), **changes)
    result_files.write(folder, results.as_json(), results.rows, results.actions)


def edited_head(folder: Path, **changes: object) -> None:
    head = json.loads((folder / "metrics.json").read_text())
    (folder / "metrics.json").write_text(json.dumps(head | changes))


def better_sum(folder: Path) -> None:
    head = json.loads((folder / "metrics.json").read_text())
    head["metrics"]["E_loc"]["value"] /= 2
    edited_head(folder, metrics=head["metrics"])


def better_row(folder: Path) -> None:
    rows = read_results(folder).rows
    rewritten(folder, rows=(rows[0] | {"E_loc": rows[0]["E_loc"] / 2}, *rows[1:]))


def another_log(folder: Path) -> None:
    actions = read_results(folder).actions
    moved = actions[1].copy()
    moved[-20:, :3] += 0.01
    rewritten(folder, actions=(actions[0], moved, *actions[2:]))


def faster_hand(folder: Path) -> None:
    actions = read_results(folder).actions
    leap = actions[2].copy()
    leap[-1, :3] += 1.0
    rewritten(folder, actions=(*actions[:2], leap, *actions[3:]))


def easy_seed_twice(folder: Path) -> None:
    results = read_results(folder)
    rewritten(folder, rows=(results.rows[0],) * 2, actions=(results.actions[0],) * 2)


def another_fingerprint(folder: Path) -> None:
    edited_head(folder, fingerprint="0123456789abcdef")


def another_version(folder: Path) -> None:
    results = read_results(folder)
    rows = tuple(row | {"benchmark": "v9"} for row in results.rows)
    rewritten(folder, rows=rows, info=replace(results.info, benchmark="v9"))


def another_interval(folder: Path) -> None:
    head = json.loads((folder / "metrics.json").read_text())
    head["per_kind"][next(iter(head["per_kind"]))]["S_loc"]["low"] += 0.125
    edited_head(folder, per_kind=head["per_kind"])


def invented_metric(folder: Path) -> None:
    head = json.loads((folder / "metrics.json").read_text())
    edited_head(folder, metrics=head["metrics"] | {"S_grace": {"value": 1.0}})


def more_attempts(folder: Path) -> None:
    results = read_results(folder)
    unmarked = replace(results.info, extra=results.info.extra | {"privileged": False})
    rewritten(folder, rows=(results.rows[0] | {"attempts": 3}, *results.rows[1:]), info=unmarked)


def played_with(folder: Path, change: Callable[[np.ndarray], np.ndarray], *rows: int) -> None:
    """Write what the changed logs of ``rows`` lead to if an episode ends with its log."""
    results = read_results(folder)
    logs = [results.log(i) for i in range(len(results.rows))]
    for i in rows:
        logs[i] = replace(logs[i], actions=change(logs[i].actions))
    recorder = ResultsRecorder()
    recorder.extend(replay(results.recipe(), logs, images=False))
    recorder.write(folder, results.info)


def longer_logs(folder: Path) -> None:
    """Give every hand more time than an evaluation does."""
    played_with(folder, lambda actions: np.concatenate([actions, actions[-1:].repeat(60, 0)]), 0, 1, 2)


def shorter_log(folder: Path) -> None:
    """Stop before the episode ends."""
    played_with(folder, lambda actions: actions[:-5], 1)


FORGERIES: list[tuple[Callable[[Path], None], str]] = [
    (better_sum, " over the episodes"),
    (better_row, "seed {0}: E_loc is "),
    (another_log, "seed {1}: "),
    (faster_hand, "seed {2}: the command of frame "),
    (easy_seed_twice, "seed {0} is there 2 times"),
    (another_interval, ".S_loc.low is "),
    (invented_metric, "metrics.S_grace"),
    (more_attempts, "seed {0} took 3 attempts; a policy has one"),
    (longer_logs, "an evaluation with them"),
    (shorter_log, "seed {1}: the log has "),
    (another_version, "are of version v9 of the benchmark, here is v"),
    (another_fingerprint, "or another recipe (0123456789abcdef, here is "),
    (lambda folder: edited_head(folder, split="val"), "names split val and capture rule attach, but its recipe plays"),
    (lambda folder: edited_head(folder, split="test_small+12345678"), "but its recipe plays test_small\n"),
]
"""What is done to a result, and what is found; ``{i}`` stands for the seed of row i."""
