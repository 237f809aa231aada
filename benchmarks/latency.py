"""What inference that takes time costs: S_loc and Q_line of checkpoints against latency, one inference at a time.

python benchmarks/latency.py CHECKPOINT [CHECKPOINT ...] [--latencies 0 50 150 370] [--split test_small] [--out FOLDER]

Writes `latency.csv` and `latency.png` into the folder, beside a result folder for each checkpoint and latency. What has
been played is not played again, so the same command goes on after an interruption, and further checkpoints or latencies
add to what is there. At a latency of 0 the world waits for the policy, as it does in `dynahoi evaluate` by default.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.cli.main import main as dynahoi
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.rollout.inference import ASYNC

mpl.use("Agg")
import matplotlib.pyplot as plt

SHIPPED = Path(__file__).parents[1] / "checkpoints" / "obact_standard"
TINY = {"policies": [SHIPPED], "latencies": [0.0, 150.0], "episodes": 2}
METRICS = {"S_loc": "S_loc, share of episodes", "Q_line": "Q_line"}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("policies", type=Path, nargs="*", default=[SHIPPED], help="checkpoint folders")
    parser.add_argument("--latencies", type=float, nargs="+", default=[0.0, 50.0, 100.0, 150.0, 250.0, 370.0])
    parser.add_argument("--mode", default=ASYNC, choices=("async", "rtc"))
    parser.add_argument("--split", default="test_small")
    parser.add_argument("--episodes", type=int, help="of the split; all by default")
    parser.add_argument("--control-class", default="standard")
    parser.add_argument("--set", action="append", default=[], help="override of the policies' configs, KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("outputs/latency"))
    args = parser.parse_args()
    rows = []
    for policy, name in zip(args.policies, names(args.policies), strict=True):
        for latency_ms in args.latencies:
            results = played(policy, latency_ms, args.out / f"{name}-{latency_ms:g}ms", args)
            rows.append({"policy": name, "latency_ms": latency_ms, "n": len(results.rows), **scores(results)})
            write_table(args.out / "latency.csv", rows)
            draw(args.out / "latency.png", rows)
    write_numbers(args, rows=rows)


def names(policies: Sequence[Path]) -> list[str]:
    """Return a different name for each checkpoint: its folder's, else its training run's, else its number."""
    found = [policy.name if policy.name != "pretrained_model" else policy.parent.name for policy in policies]
    return [f"{name}_{place}" if found.count(name) > 1 else name for place, name in enumerate(found)]


def played(policy: Path, latency_ms: float, folder: Path, args: Any) -> Results:
    """Evaluate a checkpoint at one latency, or go on with it, and return the results."""
    words = ["--policy", str(policy), "--split", args.split, "--control-class", args.control_class]
    words += ["--out", str(folder)] + [word for setting in args.set for word in ("--set", setting)]
    words += [] if args.episodes is None else ["--episodes", str(args.episodes)]
    if latency_ms:
        words += ["--inference", args.mode, "--inference-ms", f"{latency_ms:g}"]
    if dynahoi(["evaluate", *words]):
        raise SystemExit(f"dynahoi evaluate failed at {latency_ms:g} ms; the same command goes on from there")
    return read_results(folder)


def scores(results: Results) -> dict[str, float]:
    """Return value and interval of each metric of the curve."""
    found = {}
    for name in METRICS:
        estimate = results.summary()[name]
        found |= {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    return found


def write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Draw a panel for each metric and a line with its 95 % intervals for each checkpoint."""
    figure, panels = plt.subplots(1, len(METRICS), figsize=(9, 3.6), layout="constrained")
    for panel, (metric, title) in zip(panels, METRICS.items(), strict=True):
        for name in dict.fromkeys(row["policy"] for row in rows):
            curve = [row for row in rows if row["policy"] == name]
            value, low, high = ([row[metric + end] for row in curve] for end in ("", "_low", "_high"))
            below, above = ([abs(v - e) for v, e in zip(value, ends, strict=True)] for ends in (low, high))
            panel.errorbar(
                [row["latency_ms"] for row in curve], value, (below, above), marker="o", capsize=3, label=name
            )
        panel.set(xlabel="latency of inference [ms]", ylabel=title, ylim=(0, 1.03))
        panel.grid(alpha=0.3)
    panels[0].legend(frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    main()
