"""What inference that takes time costs: S_loc and Q_line of checkpoints against latency, one inference at a time.

python benchmarks/latency.py CHECKPOINT [CHECKPOINT ...] [--latencies 0 50 150 370] [--correction] [--out FOLDER]

Writes a result folder for each checkpoint and latency, and `report.html` with the curves. What has been played is not
played again, so the same command goes on after an interruption, and further checkpoints or latencies add to what is
there. At a latency of 0 the world waits for the policy, as it does in `dynahoi evaluate` by default.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.cli.main import main as dynahoi
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.report.page import render_report
from dynahoi_lerobot.rollout.inference import ASYNC

SHIPPED = Path(__file__).parents[1] / "checkpoints" / "tracker_standard"
TINY = {"policies": [SHIPPED], "latencies": [0.0, 150.0], "episodes": 2}
METRICS = ("S_loc", "Q_line")


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("policies", type=Path, nargs="*", default=[SHIPPED], help="checkpoint folders")
    parser.add_argument("--latencies", type=float, nargs="+", default=[0.0, 50.0, 100.0, 150.0, 250.0, 370.0])
    parser.add_argument("--mode", default=ASYNC, choices=("async", "rtc"))
    parser.add_argument("--correction", action="store_true", help="correct the running chunk in every frame")
    parser.add_argument("--split", default="test_small")
    parser.add_argument("--episodes", type=int, help="of the split; all by default")
    parser.add_argument("--control-class", default="standard")
    parser.add_argument("--set", action="append", default=[], help="override of the policies' configs, KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("outputs/latency"))
    args = parser.parse_args()
    rows = []
    for policy, name in zip(args.policies, names(args.policies), strict=True):
        for latency_ms in args.latencies:
            folder = args.out / f"{name}-{latency_ms:g}ms{'-corrected' * args.correction}"
            results = played(policy, latency_ms, folder, args)
            rows.append({"policy": name, "latency_ms": latency_ms, "n": len(results.rows), **scores(results)})
    render_report(sorted(path.parent for path in args.out.glob("*/metrics.json")), args.out / "report.html")
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
        words += ["--inference-correction"] if args.correction else []
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


if __name__ == "__main__":
    main()
