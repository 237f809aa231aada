"""How this checkout compares with another one, in time and memory.

    python benchmarks/against.py CHECKOUT
    python benchmarks/against.py CHECKOUT --only generation state_env --rounds 4 --json FILE

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
from pathlib import Path
from typing import Any

from support.measures import MEASURES, Settings
from support.options import REPOSITORY, benchmark_parser, parse_options, spread, write_numbers

PROGRAM = Path(__file__).parent / "support" / "measures.py"
SIZES = vars(Settings())
TINY = {
    "checkout": REPOSITORY,
    "only": ["state_env"],
    "rounds": 1,
    "num_envs": 2,
    "steps": 2,
    "episodes": 2,
    "image_size": 32,
}


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument(
        "checkout",
        type=Path,
        nargs="?",
        help="the build to compare with; this one with --tiny",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(MEASURES),
        default=list(MEASURES),
        metavar="NAME",
        help=f"measures, of {', '.join(MEASURES)}; all by default",
    )
    parser.add_argument("--rounds", type=int, default=2)
    for name, value in SIZES.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=value)
    args = parse_options(parser, TINY)
    if args.checkout is None:
        parser.error("name the CHECKOUT to compare with")
    args.checkout = args.checkout.resolve()
    tables = {name: compare(name, args) for name in args.only}
    write_numbers(args, tables=tables)


def compare(name: str, args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Measure both checkouts in turns; print and return the numbers of this one and the other, and
    their ratios.
    """
    rounds = []
    for _ in range(args.rounds):
        this = measured(name, REPOSITORY, args)
        rounds.append((this, measured(name, args.checkout, args)))
    table = {}
    for number in rounds[0][0]:
        this = [ours[number] for ours, _ in rounds]
        other = [theirs[number] for _, theirs in rounds]
        ratios = [a / b for a, b in zip(this, other, strict=True)]
        median = statistics.median(ratios)
        table[number] = {"this": this, "other": other, "ratio": ratios, "median_ratio": median}
        print(
            f"{name:17} {number:40} {statistics.median(this):9.3f} "
            f"{statistics.median(other):9.3f}   {spread(ratios)}",
            flush=True,
        )
    return table


def measured(name: str, checkout: Path, args: argparse.Namespace) -> dict[str, float]:
    """Return the numbers of one measure of one checkout, from a process of its own."""
    settings = {size: getattr(args, size) for size in SIZES}
    command = [python(checkout), str(PROGRAM), name, json.dumps(settings)]
    surroundings = os.environ | {"CUDA_VISIBLE_DEVICES": ""}
    surroundings.pop("PYTHONPATH", None)
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
