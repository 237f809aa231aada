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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

REPOSITORY = Path(__file__).parents[2]
PINNED = REPOSITORY / "tests" / "sampling" / "benchmark_digests.json"


class _SetAll(argparse.Action):
    """An option without a value that sets several others; what follows it on the command line
    wins.
    """

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Set each of ``const``, a dict of values by name."""
        for name, value in (self.const or {}).items():
            setattr(namespace, name, value)


def _output(text: str) -> Path:
    """Return the path of a file to write; refuse, before any work, one that could not be written
    after it.
    """
    place = path(text)
    try:
        check_output(place)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if place.is_dir():
        raise argparse.ArgumentTypeError(f"{place} is a folder; name a file in it")
    return place


def benchmark_parser(description: str | None, **tiny: Any) -> argparse.ArgumentParser:
    """Return a parser that knows ``--json`` and ``--tiny``.

    Args:
        description: docstring of the benchmark.
        **tiny: what ``--tiny`` sets the benchmark's own options to, so that it ends within seconds.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=_output, help="also write the numbers to this file")
    parser.add_argument(
        "--tiny",
        action=_SetAll,
        nargs=0,
        const=tiny,
        default=False,
        help="only see that it runs; numbers mean nothing",
    )
    return parser


def write_numbers(args: argparse.Namespace, **numbers: Any) -> None:
    """Write ``numbers`` to ``args.json``, if that is given, beside the settings, the machine and
    what was run.
    """
    if args.json is None:
        return
    settings = {name: value for name, value in vars(args).items() if name not in ("json", "tiny")}
    machine = {"cores": os.cpu_count(), "python": platform.python_version()}
    args.json.parent.mkdir(parents=True, exist_ok=True)
    args.json.write_text(
        json.dumps(
            {"settings": settings, "machine": machine, **provenance(), **numbers},
            indent=1,
            default=str,
        )
        + "\n"
    )


def spread(values: Sequence[float]) -> str:
    """Return the median of values, and the least and the greatest."""
    return f"{statistics.median(values):5.2f} ({min(values):.2f} to {max(values):.2f})"


def provenance() -> dict[str, str]:
    """Return the command, the commit, ``-dirty`` if files differ from it, and the name of the
    processor.
    """
    git = [
        "git",
        "-C",
        str(REPOSITORY),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=12",
        "--exclude=*",
    ]
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    names = re.findall(r"^model name\s*: (.*)$", _text(Path("/proc/cpuinfo")), re.MULTILINE)
    command = shlex.join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    return {
        "command": command,
        "commit": commit or "unknown",
        "processor": (names or [platform.machine()])[0],
    }


def pinned_benchmark() -> dict[str, str]:
    """Return the version of the benchmark and a digest of all that is pinned of it."""
    return {
        "version": BENCHMARK.version,
        "digest": hashlib.sha256(PINNED.read_bytes()).hexdigest()[:16],
    }


def _text(path: Path) -> str:
    return path.read_text() if path.exists() else ""
