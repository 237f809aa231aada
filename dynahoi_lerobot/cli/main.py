"""``dynahoi <command>``: the commands that LeRobot does not have."""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from dynahoi_lerobot.foundation.output import check_output

COMMANDS = {
    "quickstart": ("dynahoi_lerobot.cli.quickstart", "generate, train, evaluate and report, on a CPU in minutes"),
    "generate": ("dynahoi_lerobot.onpolicy.generate_command", "write a LeRobotDataset of expert or on-policy episodes"),
    "verify": ("dynahoi_lerobot.verify.command", "check every promise about a dataset on disk"),
    "filter": ("dynahoi_lerobot.verify.filter_command", "copy a dataset without the paper's outliers"),
    "pretrain": ("dynahoi_lerobot.onpolicy.pretrain_command", "train a policy's eye on pictures of random poses"),
    "dagger": ("dynahoi_lerobot.onpolicy.command", "train a policy on its own episodes, with a teacher, in memory"),
    "evaluate": ("dynahoi_lerobot.evaluate.command", "run a policy or an expert on a split and compute every metric"),
    "certify": ("dynahoi_lerobot.evaluate.certify_command", "replay an evaluation and compare every metric"),
    "report": ("dynahoi_lerobot.report.command", "tables and plots of result folders as one HTML page"),
    "push": ("dynahoi_lerobot.hub.command", "upload a dataset, checkpoint, results or environment to the Hub"),
    "view": ("dynahoi_lerobot.cli.view", "write an episode as GIF, MP4 or web page"),
    "doctor": ("dynahoi_lerobot.doctor.command", "say what this machine has, what is wrong, and what follows"),
    "list": ("dynahoi_lerobot.cli.listing", "list motions, objects, metrics and other registered names"),
}
"""Command: module with ``add_arguments`` and ``run``, and one line of help. A module is imported when it is used."""

BAD_INPUT = 2
STOPPED = 130
VERBOSE_LOGGERS = ("lerobot.utils.import_utils",)
"""Loggers whose warnings are no news here: that torchcodec cannot be used, in 90 lines; `dynahoi doctor` says it."""
LONGEST = 800
"""Characters of a message; the longest that names no value of the user's lists 24 motions."""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with an argument in one sentence, without the whole usage before it."""

    def __init__(self, **options: Any) -> None:
        """Take no abbreviated options: results store the command line, with only the whole ``--salt`` hidden."""
        super().__init__(**options, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Raise a ValueError, which ``main`` prints."""
        raise ValueError(f"{message.removeprefix('argument ')}; see `{self.prog} --help`")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failed, 2 bad input, 130 stopped."""
    for name in VERBOSE_LOGGERS:
        logging.getLogger(name).setLevel(logging.ERROR)
    words = list(sys.argv[1:] if argv is None else argv)
    parser = _Parser(prog="dynahoi", description="Catching moving objects with a dexterous hand.")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (module, text) in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        if words[:1] == [name]:
            importlib.import_module(module).add_arguments(command)
    spoken = " ".join(["dynahoi", *(word for word in words[:1] if word in COMMANDS)])
    try:
        args = parser.parse_args(words)
        _check_outputs(args)
        return importlib.import_module(COMMANDS[args.command][0]).run(args)
    except (ValueError, OSError) as error:
        print(f"{spoken}: {_shortened(str(error))}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"{spoken}: stopped", file=sys.stderr)
        return STOPPED


def _shortened(sentence: str) -> str:
    """Leave out the middle of a sentence that names a value of thousands of characters."""
    return sentence if len(sentence) <= LONGEST else f"{sentence[: LONGEST // 2]} ... {sentence[-LONGEST // 2 :]}"


def _check_outputs(args: argparse.Namespace) -> None:
    """Refuse, before any work, an ``--out PLACE`` or a ``--json FILE`` that could not be written after it."""
    path, out = getattr(args, "json", None), getattr(args, "out", None)
    if isinstance(path, Path) and (path.is_dir() or not path.parent.is_dir()):
        raise ValueError(f"--json must name a file in an existing folder, got {path}")
    for place in (path, out):
        if isinstance(place, Path):
            check_output(place)


def entry() -> None:
    """Console script: exit with the command's code."""
    sys.exit(main())


if __name__ == "__main__":
    entry()
