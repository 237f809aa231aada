"""How training in memory goes: validation scores against processor minutes, from the logs of `dynahoi dagger`.

python docs/scripts/learning_curves.py outputs/standard outputs/unlimited [--metric S_loc] --out curves.png

A run that starts from the policy of another begins where that one ended, so name that one with --after NAME=OTHER.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt


def main() -> None:
    """Draw the curves of the runs that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="folders with a log.jsonl")
    parser.add_argument("--metric", default="S_loc")
    parser.add_argument("--eye-minutes", type=float, default=0.0, help="processor minutes that its eye took before")
    parser.add_argument("--after", action="append", default=[], metavar="NAME=OTHER")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    curves = {run.name: validations(run / "log.jsonl", args.metric) for run in args.runs}
    begins = dict.fromkeys(curves, args.eye_minutes)
    for name, other in (pair.split("=") for pair in args.after):
        begins[name] += curves[other][-1][0]
    figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for name, points in curves.items():
        minutes, scores = zip(*points, strict=True)
        axes.plot([begins[name] + minute for minute in minutes], scores, marker="o", label=name)
    axes.set(
        xlabel=f"processor minutes, eye {'included' if args.eye_minutes else 'not included'}",
        ylabel=f"{args.metric} on val [%]",
        xlim=(0, None),
        ylim=(0, 100),
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="lower left")
    figure.savefig(args.out, dpi=110)


def validations(log: Path, metric: str) -> list[tuple[float, float]]:
    """Return processor minutes and score of each validation that a log tells."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return [(line["processor_minutes"], line["val"][metric]) for line in lines if "val" in line]


if __name__ == "__main__":
    main()
