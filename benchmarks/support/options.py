"""The options that all benchmarks share, and the file in which they leave their numbers."""

import argparse
import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.core.files import check_output


class _SetAll(argparse.Action):
    """An option without a value that sets several others; what follows it on the command line wins."""

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
    """Return the path of a file to write; refuse, before any work, one that could not be written after it."""
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
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=_output, help="also write the numbers to this file")
    parser.add_argument(
        "--tiny", action=_SetAll, nargs=0, const=tiny, default=False, help="only see that it runs; numbers mean nothing"
    )
    return parser


def write_numbers(args: argparse.Namespace, **numbers: Any) -> None:
    """Write ``numbers`` beside the settings and the machine to ``args.json``, if that is given."""
    if args.json is None:
        return
    settings = {name: value for name, value in vars(args).items() if name not in ("json", "tiny")}
    machine = {"cores": os.cpu_count(), "processor": platform.machine(), "python": platform.python_version()}
    args.json.parent.mkdir(parents=True, exist_ok=True)
    args.json.write_text(
        json.dumps({"settings": settings, "machine": machine, **numbers}, indent=2, default=str) + "\n"
    )
