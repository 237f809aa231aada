"""``dynahoi verify``: run every check on a dataset on disk and print the findings."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from dynahoi_lerobot.core.arguments import path, whole
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.verify.checks.base import Finding
from dynahoi_lerobot.verify.runner import DECODED, verify

if TYPE_CHECKING:
    from dynahoi_lerobot.rollout.replay import Resimulate

PASSED, FAILED, BAD_INPUT = 0, 1, 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi verify``."""
    parser.add_argument("root", type=path, help="the dataset's folder")
    parser.add_argument("--decode", default=str(DECODED), help="episodes whose pictures are decoded, or 'all'")
    parser.add_argument(
        "--replay", type=whole(0, 10**9), default=0, help="episodes to make again from their seeds and to compare"
    )
    parser.add_argument("--json", type=path, help="write the findings there as well")


def run(args: argparse.Namespace, *, resimulate: Resimulate | None = None) -> int:
    """Verify a dataset and print the findings.

    Args:
        args: the parsed arguments of ``add_arguments``.
        resimulate: makes the episode of a seed; this project's simulator by default.

    Returns:
        The exit code: 0 no findings, 1 findings, 2 bad input.
    """
    try:
        decoded = _decoded(args.decode)
        Store(args.root)  # raises where there is no dataset
    except (OSError, ValueError) as error:
        print(f"dynahoi verify: {error}", file=sys.stderr)
        return BAD_INPUT
    with tqdm(total=_episodes(args.root), unit="episode", disable=None) as bar:

        def show(done: int) -> None:
            bar.update(done - bar.n)

        findings = verify(args.root, decoded=decoded, replayed=args.replay, resimulate=resimulate, progress=show)
    _report(args, findings)
    return FAILED if findings else PASSED


def _report(args: argparse.Namespace, findings: list[Finding]) -> None:
    for finding in findings:
        print(finding)
    found = f"{len(findings)} findings" if findings else f"{_episodes(args.root)} episodes, no findings"
    print(f"{args.root}: {found}")
    if args.json:
        args.json.write_text(json.dumps([asdict(finding) for finding in findings], indent=2))


def _episodes(root: Path) -> int | None:
    """Return how many episodes the manifest promises, None where there is none that can be read."""
    try:
        return Manifest.read(root).episodes
    except (OSError, ValueError):
        return None


def _decoded(text: str) -> int | None:
    if text == "all":
        return None
    if not text.isdigit():
        raise ValueError(f"--decode is {text!r}; it is a number of episodes or 'all'")
    return int(text)
