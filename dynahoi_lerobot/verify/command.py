"""``dynahoi verify``: run every check on a dataset on disk and print the findings."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.features import CAMERA_KEY
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.verify.runner import DECODED, verify

if TYPE_CHECKING:
    from dynahoi_lerobot.rollout.replay import Resimulate

PASSED, FAILED, BAD_INPUT = 0, 1, 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi verify``."""
    parser.add_argument("root", type=Path, help="the dataset's folder")
    parser.add_argument("--decode", default=str(DECODED), help="episodes whose pictures are decoded, or 'all'")
    parser.add_argument("--replay", type=int, default=0, help="episodes to simulate again from their actions")
    parser.add_argument("--json", type=Path, help="write the findings there as well")


def run(args: argparse.Namespace, *, resimulate: Resimulate | None = None) -> int:
    """Verify a dataset and print the findings.

    Args:
        args: the parsed arguments of ``add_arguments``.
        resimulate: plays (T, 18) actions in the world of an episode; this project's simulator by default.

    Returns:
        The exit code: 0 no findings, 1 findings, 2 bad input.
    """
    try:
        decoded = _decoded(args.decode)
        episodes = Store(args.root).episodes
        simulator = (resimulate or _simulator(args.root)) if args.replay else None
    except (OSError, ValueError, KeyError) as error:
        print(f"dynahoi verify: {error}", file=sys.stderr)
        return BAD_INPUT
    with tqdm(total=episodes, unit="episode", disable=None) as bar:

        def show(done: int) -> None:
            bar.update(done - bar.n)

        findings = verify(args.root, decoded=decoded, resimulate=simulator, replayed=args.replay, progress=show)
    for finding in findings:
        print(finding)
    print(f"{args.root}: {len(findings)} findings" if findings else f"{args.root}: {episodes} episodes, no findings")
    if args.json:
        args.json.write_text(json.dumps([asdict(finding) for finding in findings], indent=2))
    return FAILED if findings else PASSED


def _decoded(text: str) -> int | None:
    if text == "all":
        return None
    if not text.isdigit():
        raise ValueError(f"--decode is {text!r}; it is a number of episodes or 'all'")
    return int(text)


def _simulator(root: Path) -> Resimulate:
    from dynahoi_lerobot.rollout.replay import simulator

    made_with = Manifest.read(root).provenance
    if made_with.get("code") != code_fingerprint():
        raise ValueError(
            f"{root} was made by other code ({made_with.get('code')}, here is {code_fingerprint()}); only the same "
            "code replays it"
        )
    return simulator(made_with["recipe"], images=CAMERA_KEY in Store(root).features)
