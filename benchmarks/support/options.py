"""The options that all benchmarks share, and how they tell and store their numbers."""

import argparse
import hashlib
import json
import os
import platform
import re
import shlex
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

REPOSITORY = Path(__file__).parents[2]
PINNED = REPOSITORY / "tests" / "sampling" / "benchmark_digests.json"
"""The digests that `pin.py` writes."""
CPU_INFO = Path("/proc/cpuinfo")


def benchmark_parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser that knows ``--json`` and ``--tiny`` and shows a docstring as it is."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=path, help="also write the numbers to this file")
    parser.add_argument(
        "--tiny", action="store_true", help="only see that it runs; numbers mean nothing"
    )
    return parser


def parse_options(parser: argparse.ArgumentParser, tiny: Mapping[str, Any]) -> argparse.Namespace:
    """Return the options of the command line.

    ``--tiny`` replaces the defaults by ``tiny``, with which the benchmark ends within seconds. A
    ``--json`` that could not be written after the work is refused before it.
    """
    args = parser.parse_args()
    if args.tiny:
        parser.set_defaults(**tiny)
        args = parser.parse_args()
    if args.json is not None:
        try:
            check_output(args.json)
        except ValueError as error:
            parser.error(f"argument --json: {error}")
        if args.json.is_dir():
            parser.error(f"argument --json: {args.json} is a folder; name a file in it")
    return args


def write_numbers(args: argparse.Namespace, **numbers: Any) -> None:
    """Write ``numbers`` to ``args.json``, if that is given, beside the settings, the machine and
    what was run.
    """
    if args.json is None:
        return
    settings = {name: value for name, value in vars(args).items() if name not in ("json", "tiny")}
    machine = {"cores": os.cpu_count(), "python": platform.python_version()}
    content = {"settings": settings, "machine": machine, **provenance(), **numbers}
    args.json.parent.mkdir(parents=True, exist_ok=True)
    args.json.write_text(json.dumps(content, indent=1, default=str) + "\n")


def spread(values: Sequence[float]) -> str:
    """Return the median of values, and the least and the greatest."""
    return f"{statistics.median(values):5.2f} ({min(values):.2f} to {max(values):.2f})"


def provenance() -> dict[str, str]:
    """Return the command, the commit, ``-dirty`` if files differ from it, and the name of the
    processor.
    """
    git = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    described = subprocess.run(git, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    cpu_info = CPU_INFO.read_text() if CPU_INFO.exists() else ""
    processor = re.search(r"^model name\s*: (.*)$", cpu_info, re.MULTILINE)
    return {
        "command": shlex.join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]]),
        "commit": described.stdout.strip() or "unknown",
        "processor": processor[1] if processor else platform.machine(),
    }


def pinned_benchmark() -> dict[str, str]:
    """Return the version of the benchmark and a digest of all that is pinned of it."""
    digest = hashlib.sha256(PINNED.read_bytes()).hexdigest()[:16]
    return {"version": BENCHMARK.version, "digest": digest}
