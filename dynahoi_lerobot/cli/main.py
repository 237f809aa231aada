"""``dynahoi <command>``: the commands that LeRobot does not have."""

import argparse
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NoReturn, TextIO, cast

from dynahoi_lerobot import __version__
from dynahoi_lerobot.core.arguments import BAD_INPUT, CommandError, add_options, read_options
from dynahoi_lerobot.core.caches import ensure_caches
from dynahoi_lerobot.core.escaping import Terminal, shortened
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.core.lerobot_internals import video_backend_unspoken

COMMANDS = {
    "quickstart": (
        "dynahoi_lerobot.cli.quickstart",
        "generate, train, evaluate and report on a CPU in minutes",
    ),
    "generate": (
        "dynahoi_lerobot.generate.command",
        "record a LeRobotDataset of expert or on-policy episodes",
    ),
    "verify": (
        "dynahoi_lerobot.verify.command",
        "check a dataset on disk, optionally by replaying episodes",
    ),
    "filter": (
        "dynahoi_lerobot.verify.filter",
        "copy a dataset without outliers as the paper defines them",
    ),
    "encode": (
        "dynahoi_lerobot.encode",
        "copy a dataset with what an image encoder sees instead of images",
    ),
    "pretrain": ("dynahoi_lerobot.pretrain.command", "pretrain an image encoder on random poses"),
    "evaluate": ("dynahoi_lerobot.evaluate.command", "evaluate a policy or a baseline on a split"),
    "report": ("dynahoi_lerobot.report.page", "write an HTML report of result folders"),
    "play": (
        "dynahoi_lerobot.play.command",
        "serve a page on which a person catches, is scored and records",
    ),
    "push": (
        "dynahoi_lerobot.hub",
        "upload a dataset, a checkpoint, results or the environment to the Hub",
    ),
    "view": ("dynahoi_lerobot.cli.view", "render an episode as GIF, MP4 or HTML"),
    "doctor": ("dynahoi_lerobot.doctor", "check this machine and installation"),
    "list": ("dynahoi_lerobot.cli.listing", "list registered motions, objects, metrics, ..."),
}
"""Command: module, imported on use, and one line of help.

Its dataclass ``Options`` describes the command line; its ``run`` takes one and returns the exit
code, or raises what ``exit_code`` puts into a sentence: ValueError, FileExistsError and
FileNotFoundError for bad input, CommandError and OSError for a failure.
"""

FAILED = 1
STOPPED = 130
CLOSED = 141
"""Exit codes beside ``BAD_INPUT``; the last two as shells have them for programs ended by SIGINT
and SIGPIPE."""
EXTRAS = {
    "datatrove": "scale",
    "ray": "scale",
    "openai": "vlm",
    "aiohttp": "play",
}
EXTRAS |= dict.fromkeys(("lerobot", "torch", "huggingface_hub", "httpx"), "lerobot")
"""Extra that installs a package."""
LONGEST = 800
"""Longest message [characters]; the longest without user input lists 24 motions."""


class _Parser(argparse.ArgumentParser):
    """Reports a bad argument in one sentence, without the usage text."""

    def __init__(self, **options: Any) -> None:
        """Disallow abbreviated options: results store the command line, in which only the full
        ``--salt`` is hidden.
        """
        super().__init__(**options, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Raise a ValueError, which ``main`` prints."""
        raise ValueError(f"{message.removeprefix('argument ')}; see `{self.prog} --help`")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 success, 1 failure, 2 bad input, 130
    interrupted.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    parser = _Parser(prog="dynahoi", description="Catching moving objects with a dexterous hand.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (_, text) in COMMANDS.items():
        commands.add_parser(name, help=text, description=text)
    spoken = " ".join(["dynahoi", *(word for word in words[:1] if word in COMMANDS)])

    with suppress(ValueError):  # outside the main thread
        # an exit removes what is half made
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))

    def run() -> int:
        ensure_caches()
        name = parser.parse_args(words[:1]).command
        command = importlib.import_module(COMMANDS[name][0])
        add_options(commands.choices[name], command.Options)
        options = read_options(command.Options, vars(commands.choices[name].parse_args(words[1:])))
        _check_outputs(options)
        with video_backend_unspoken():
            return command.run(options)

    return exit_code(spoken, run)


def exit_code(spoken: str, run: Callable[[], int]) -> int:
    """Return the exit code of ``run``, or print in one sentence, after what was ``spoken``, what
    stopped it.
    """
    out = cast("TextIO", Terminal(sys.stdout))
    err = cast("TextIO", Terminal(sys.stderr))
    with redirect_stdout(out), redirect_stderr(err), _left_out_in_one_line(spoken):
        try:
            code = run()
            sys.stdout.flush()
            return code
        except BrokenPipeError:  # the reader, such as `head`, has had enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return CLOSED
        except ModuleNotFoundError as error:
            extra = EXTRAS.get((error.name or "").partition(".")[0])
            remedy = f"which the extra `{extra}` installs" if extra else "which is not installed"
            sentence = f"it needs {error.name}, {remedy}"
            code = BAD_INPUT
        except (ValueError, FileExistsError, FileNotFoundError) as error:
            sentence = _sentence(error)
            code = BAD_INPUT
        except (OSError, CommandError) as error:
            sentence = _sentence(error)
            code = FAILED
        except KeyboardInterrupt as error:
            sentence = "; ".join(["interrupted", *map(str, error.args)])
            code = STOPPED
        print(f"{spoken}: {sentence}", file=sys.stderr)
        return code


@contextmanager
def _left_out_in_one_line(spoken: str) -> Iterator[None]:
    """Print what a reader leaves out in one sentence, as errors are, without a line of source."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
            from dynahoi_lerobot.core.reading import LeftOut  # which brings in NumPy

            if issubclass(category, LeftOut):
                print(f"{spoken}: {shortened(str(message), LONGEST)}", file=sys.stderr)
            else:
                usual(message, category, *where)

        warnings.showwarning = show
        yield


def _sentence(error: Exception) -> str:
    """Return the message in one line, without its middle if a value makes it very long."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return shortened(text, LONGEST)


def _check_outputs(options: object) -> None:
    """Refuse an unwritable ``--out``, or another file to write, before any work starts."""
    for name in ("json", "csv", "latex"):
        path = getattr(options, name, None)
        if isinstance(path, Path) and (path.is_dir() or not path.parent.is_dir()):
            raise ValueError(f"--{name} must name a file in an existing folder, got {path}")
    out = getattr(options, "out", None)
    if isinstance(out, Path):
        check_output(out)


if __name__ == "__main__":
    sys.exit(main())
