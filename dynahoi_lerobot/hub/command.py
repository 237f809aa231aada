"""``dynahoi push``: upload a dataset, a checkpoint, results or an environment to the Hugging Face Hub."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.hub.contents import (
    Contents,
    checkpoint_contents,
    dataset_contents,
    environment_contents,
    kind_of,
    results_contents,
)
from dynahoi_lerobot.hub.failures import RESUME, HubError
from dynahoi_lerobot.hub.repository import Repository
from dynahoi_lerobot.verify.runner import verify

DONE, FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi push``."""
    parser.add_argument(
        "folder",
        type=path,
        help="a dataset, a pretrained_model folder, results of evaluate, or envs/hub",
    )
    parser.add_argument("repo", help="USER/NAME on the Hub; results go to their checkpoint's repository")
    parser.add_argument("--private", action="store_true", help="create a private repository")
    parser.add_argument(
        "--replace", action="store_true", help="checkpoints only: replace other weights and remove their results"
    )
    parser.add_argument("--policy", help="results only: the policy that was evaluated, if it had another name")


def run(args: argparse.Namespace) -> int:
    """Check the folder, push it and print its address.

    Args:
        args: the parsed arguments of ``add_arguments``.

    Returns:
        The exit code: 0 success, 1 refused or failed, 2 bad input, 130 interrupted.
    """
    try:
        kind = kind_of(args.folder)
        _check_options(kind, args)
        repository = Repository.open(args.repo)
        if kind == "dataset" and not _is_sound(args.folder):
            return _say(f"{args.folder} was not pushed: `dynahoi verify` has findings", FAILED)
        with TemporaryDirectory() as stage:
            layout = Path(stage) / args.folder.resolve().name
            contents = _contents(kind, args, layout)
            address = repository.push(contents, args.private, replace=args.replace, policy=args.policy or "")
    except ModuleNotFoundError as error:
        return _say(f"it needs {error.name}, which the extra `lerobot` installs", BAD_INPUT)
    except HubError as error:
        return _say(error, FAILED)
    except KeyboardInterrupt:
        return _say(f"interrupted; {RESUME}", STOPPED)
    print(f"{kind} pushed to {address}" + (f", tagged {', '.join(contents.tags)}" if contents.tags else ""))
    return DONE


def _is_sound(root: Path) -> bool:
    """Run the checks of ``dynahoi verify`` and print the findings."""
    findings = verify(root)
    for finding in findings:
        print(finding, file=sys.stderr)
    return not findings


def _check_options(kind: str, args: argparse.Namespace) -> None:
    """Refuse options that do not apply.

    Raises:
        ValueError: naming one, and what is pushed.
    """
    for wanted, options in (("results", ("policy",)), ("checkpoint", ("replace",))):
        for option in options:
            if getattr(args, option) and kind != wanted:
                raise ValueError(f"--{option} is for a push of {wanted}; {args.folder} holds this: {kind}")


def _contents(kind: str, args: argparse.Namespace, stage: Path) -> Contents:
    if kind == "dataset":
        return dataset_contents(args.folder)
    if kind == "checkpoint":
        return checkpoint_contents(args.folder, args.repo)
    if kind == "environment":
        return environment_contents(args.folder)
    return results_contents(args.folder, stage)


def _say(problem: object, code: int) -> int:
    print(f"dynahoi push: {problem}", file=sys.stderr)
    return code
