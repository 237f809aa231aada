"""``dynahoi filter``: copy a dataset without the episodes that the paper's outlier rule rejects."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.subset import copy_subset
from dynahoi_lerobot.verify.outliers import MARGIN, Outlier, find_outliers

DONE, FAILED, BAD_INPUT = 0, 1, 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi filter``."""
    parser.add_argument("root", type=path, help="the dataset's folder; it is left as it is")
    parser.add_argument("--out", type=path, help="folder of the new dataset; must not exist")
    parser.add_argument(
        "--margin",
        type=float,
        default=MARGIN,
        help="allowed beyond [q01, q99] on either side, in widths of it",
    )
    parser.add_argument("--column", default="action", help="the column that is looked at")
    parser.add_argument("--dry-run", action="store_true", help="only print what would be left out")
    parser.add_argument("--json", type=path, help="write the summary there as well")


def run(args: argparse.Namespace) -> int:
    """Print the outliers and copy all other episodes.

    Args:
        args: the parsed arguments of ``add_arguments``.

    Returns:
        The exit code: 0 done, 1 the disk failed, 2 bad input.
    """
    try:
        output = _output(args)
        episodes = Store(args.root).episodes
        outliers = find_outliers(args.root, args.margin, args.column)
        if output is not None:
            left_out = {outlier.episode for outlier in outliers}
            copy_subset(args.root, output, [index for index in range(episodes) if index not in left_out])
        _report(args, episodes, outliers)
    except (ValueError, KeyError, FileExistsError, FileNotFoundError) as error:
        return _say(error, BAD_INPUT)
    except OSError as error:
        return _say(error, FAILED)
    return DONE


def _output(args: argparse.Namespace) -> Path | None:
    """Return where the new dataset goes, None in a dry run."""
    if args.dry_run:
        return None
    if args.out is None:
        raise ValueError("say where the new dataset goes with --out DIR, or --dry-run to see what it would lack")
    if args.out.exists():
        raise FileExistsError(f"{args.out} exists; choose a new folder")
    return args.out


def _report(args: argparse.Namespace, episodes: int, outliers: list[Outlier]) -> None:
    for outlier in outliers:
        print(outlier)
    where = "dry run, nothing was written" if args.dry_run else f"the others are in {args.out}"
    print(f"{args.root}: {len(outliers)} of {episodes} episodes left out; {where}")
    if args.json:
        args.json.write_text(json.dumps(_summary(args, episodes, outliers), indent=2))


def _summary(args: argparse.Namespace, episodes: int, outliers: list[Outlier]) -> dict[str, Any]:
    return {
        "root": str(args.root),
        "out": None if args.dry_run else str(args.out),
        "column": args.column,
        "margin": args.margin,
        "episodes": episodes,
        "kept": episodes - len(outliers),
        "left_out": [asdict(outlier) for outlier in outliers],
    }


def _say(problem: object, code: int) -> int:
    print(f"dynahoi filter: {problem}", file=sys.stderr)
    return code
