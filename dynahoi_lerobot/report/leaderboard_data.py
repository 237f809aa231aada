"""What the leaderboard page shows.

``python -m dynahoi_lerobot.report.leaderboard_data RESULTS ... --out envs/leaderboard/results.json`` writes it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynahoi_lerobot.foundation.arguments import path
from dynahoi_lerobot.foundation.output import check_output
from dynahoi_lerobot.hub.leaderboards import directions, ranking_metrics, why_unranked
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.sampling.benchmark import BENCHMARK


def leaderboard_data(folders: Sequence[Path]) -> dict[str, Any]:
    """Return the results that are on a leaderboard, best S_loc first.

    Raises:
        ResultsError: if a folder cannot be read.
        MixedError: if they are of different versions of the benchmark, or of different salts.
        ValueError: if a result is on no leaderboard: another split, track, version, or not all of the split.
    """
    return {
        "benchmark": BENCHMARK.version,
        "directions": directions(),
        "results": [_row(entry) for entry in read_entries(folders)],
    }


def _row(entry: Entry) -> dict[str, Any]:
    results = entry.results
    if reason := why_unranked(results):
        raise ValueError(f"{results.folder} is on no leaderboard: {reason}")
    info = results.info
    metrics = ranking_metrics(info.split, info.capture, results.control_class)
    return {
        "policy": entry.label,
        "split": info.split,
        "capture": info.capture,
        "control_class": results.control_class,
        "protocol": results.protocol,
        "n": len(results.rows),
        "metrics": {name: entry.summary[name].as_json() for name in metrics},
    }


def main() -> None:
    """Write the file that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=path, nargs="+", help="result folders of dynahoi evaluate")
    parser.add_argument("--out", type=path, required=True, help="the page's results.json")
    args = parser.parse_args()
    check_output(args.out)
    args.out.write_text(json.dumps(leaderboard_data(args.results), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
