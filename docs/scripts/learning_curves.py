"""How training goes: S_loc against minutes on one CPU core, of on-policy runs and of policies that learned from data.

python docs/scripts/learning_curves.py outputs/standard outputs/two_views --results outputs/baselines/results/* \
    --out curves.png

A curve is what `dynahoi dagger` logged of its own training episodes; a point is the test of a policy that
`recipes/study/run.py` trained, with its 95 % interval.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

SMOOTHED_ROUNDS = 6
"""A round has about fifty episodes of the policy; a point of a curve is the mean of so many rounds."""


def main() -> None:
    """Draw the curves of the runs and the points of the results that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="folders with a log.jsonl")
    parser.add_argument("--results", type=Path, nargs="*", default=[], help="folders of a study with a metrics.json")
    parser.add_argument("--metric", default="S_loc")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for run in args.runs:
        minutes, scores = training_scores(run / "log.jsonl", args.metric)
        axes.plot(minutes, scores, label=f"Tracker, its own states: {run.name}")
    for folder in args.results:
        draw_result(axes, json.loads((folder / "metrics.json").read_text()), args.metric)
    axes.set(xlabel="minutes on one CPU core", ylabel=f"{args.metric} [%]", xlim=(0, None), ylim=(0, 100))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(args.out, dpi=110)


def training_scores(log: Path, metric: str) -> tuple[np.ndarray, np.ndarray]:
    """Return processor minutes and smoothed scores [%] of the rounds in which the policy moved the hand."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    played = [(line["processor_minutes"], line["train"][metric]) for line in lines if line["train"][metric] is not None]
    minutes, scores = np.array(played).T
    kernel = np.full(min(SMOOTHED_ROUNDS, len(scores)), 1 / min(SMOOTHED_ROUNDS, len(scores)))
    return minutes[len(kernel) - 1 :], np.convolve(scores, kernel, mode="valid")


def draw_result(axes: Axes, result: dict, metric: str) -> None:
    """Draw the score of a policy at the time that its training took; baselines that did not train are left out."""
    seconds, score = result["extra"].get("training_seconds"), result["metrics"][metric]
    if seconds is None:
        return
    value, low, high = (100 * score[key] for key in ("value", "low", "high"))
    errors = [[value - low], [high - value]]
    axes.errorbar([seconds / 60], [value], yerr=errors, fmt="o", capsize=3, label=result["policy"])


if __name__ == "__main__":
    main()
