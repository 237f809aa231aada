"""How this checkout compares with another one, in time and memory.

python benchmarks/against.py CHECKOUT [--only NAME ...] [--rounds 2] [--processes 2] [--json FILE]

CHECKOUT is a clone of the build to compare with, with an environment of its own (`uv sync` in it).
The two take turns (A B, A B), every measurement is a process of its own, and a row is the median
over the rounds of this checkout's number divided by the other's, with the least and the greatest.
Times and megabytes are better below 1. CPU time is that of a process with its children; other
programs hardly change it. Wall times mean something on idle cores only.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from support.measures import MEASURES, Settings
from support.options import REPOSITORY, benchmark_parser, spread, write_numbers

PROGRAM = Path(__file__).parent / "support" / "measures.py"
SIZES = {field.name: field.default for field in fields(Settings)}
TINY = {
    "itself": True,
    "only": ["state_env"],
    "rounds": 1,
    "num_envs": 2,
    "steps": 2,
    "episodes": 2,
    "image_size": 32,
}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument(
        "checkout",
        type=Path,
        nargs="?",
        help="the build to compare with; this one with --tiny",
    )
    parser.add_argument(
        "--only", nargs="+", choices=list(MEASURES), default=list(MEASURES), metavar="NAME",
        help=f"measures, of {', '.join(MEASURES)}; all by default",
    )  # fmt: skip
    parser.add_argument("--rounds", type=int, default=2)
    for name, value in SIZES.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=value)
    parser.set_defaults(itself=False)
    args = parser.parse_args()
    if not (args.checkout or args.itself):
        parser.error("name the CHECKOUT to compare with")
    args.checkout = (args.checkout or REPOSITORY).resolve()
    tables = {name: compare(name, args) for name in args.only}
    write_numbers(args, tables=tables)


def compare(name: str, args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Measure both checkouts in turns; print and return the numbers of this one and the other, and
    their ratios.
    """
    rounds = [
        {
            "this": measured(name, REPOSITORY, args),
            "other": measured(name, args.checkout, args),
        }
        for _ in range(args.rounds)
    ]
    table = {}
    for number in rounds[0]["this"]:
        row = {side: [one[side][number] for one in rounds] for side in ("this", "other")}
        row["ratio"] = [a / b for a, b in zip(row["this"], row["other"], strict=True)]
        table[number] = row | {"median_ratio": statistics.median(row["ratio"])}
        print(
            f"{name:17} {number:40} {statistics.median(row['this']):9.3f} "
            f"{statistics.median(row['other']):9.3f}   {spread(row['ratio'])}",
            flush=True,
        )
    return table


def measured(name: str, checkout: Path, args: argparse.Namespace) -> dict[str, float]:
    """Return the numbers of one measure of one checkout, from a process of its own."""
    settings = {name: getattr(args, name) for name in SIZES}
    command = [python(checkout), str(PROGRAM), name, json.dumps(settings)]
    surroundings = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    surroundings["CUDA_VISIBLE_DEVICES"] = ""
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{checkout} cannot be measured: {done.stderr.strip()[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def python(checkout: Path) -> str:
    """Return the interpreter of a checkout's environment; of this one, that which runs."""
    if checkout == REPOSITORY:
        return sys.executable
    interpreter = checkout / ".venv" / "bin" / "python"
    if not interpreter.exists():
        raise SystemExit(f"{checkout} has no .venv; run `uv sync` in it")
    return str(interpreter)


if __name__ == "__main__":
    main()
