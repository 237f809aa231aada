"""``dynahoi <command>``: the commands that LeRobot does not have."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

COMMANDS = {
    "quickstart": ("dynahoi_lerobot.cli.quickstart", "generate, train, evaluate and report, on a CPU in minutes"),
    "generate": ("dynahoi_lerobot.generate.command", "write a LeRobotDataset of expert episodes"),
    "verify": ("dynahoi_lerobot.verify.command", "check every promise about a dataset on disk"),
    "filter": ("dynahoi_lerobot.verify.filter_command", "copy a dataset without the paper's outliers"),
    "evaluate": ("dynahoi_lerobot.evaluate.command", "run a policy or an expert on a split and compute every metric"),
    "report": ("dynahoi_lerobot.report.command", "tables and plots of result folders as one HTML page"),
    "view": ("dynahoi_lerobot.cli.view", "write an episode as GIF, MP4 or web page"),
    "list": ("dynahoi_lerobot.cli.listing", "list motions, objects, metrics and other registered names"),
}
"""Command: module with ``add_arguments`` and ``run``, and one line of help. A module is imported when it is used."""

BAD_INPUT = 2
STOPPED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failed, 2 bad input, 130 stopped."""
    words = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(prog="dynahoi", description="Catching moving objects with a dexterous hand.")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (module, text) in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        if words[:1] == [name]:
            importlib.import_module(module).add_arguments(command)
    args = parser.parse_args(words)
    try:
        _check_summary_file(getattr(args, "json", None))
        return importlib.import_module(COMMANDS[args.command][0]).run(args)
    except (ValueError, OSError) as error:
        print(f"dynahoi {args.command}: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"dynahoi {args.command}: stopped", file=sys.stderr)
        return STOPPED


def _check_summary_file(path: object) -> None:
    """Refuse, before any work, a ``--json FILE`` that could not be written after it."""
    if isinstance(path, Path) and (path.is_dir() or not path.parent.is_dir()):
        raise ValueError(f"--json must name a file in an existing folder, got {path}")


def entry() -> None:
    """Console script: exit with the command's code."""
    sys.exit(main())


if __name__ == "__main__":
    entry()
