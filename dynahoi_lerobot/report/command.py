"""``dynahoi report``: result folders as one HTML page."""

from __future__ import annotations

import argparse
from itertools import combinations
from pathlib import Path

from dynahoi_lerobot.evaluate.compare import CROSSABLE, command_distances_cm, compare, unequal_conditions
from dynahoi_lerobot.evaluate.intervals import bootstrap
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.foundation.arguments import path
from dynahoi_lerobot.report.page import render_report
from dynahoi_lerobot.sampling.benchmark import ALLOW_MISMATCH


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi report``."""
    parser.add_argument("folders", type=path, nargs="+", help="result folders of `dynahoi evaluate`")
    parser.add_argument(ALLOW_MISMATCH, action="store_true", help="accept results of different benchmark versions")
    parser.add_argument(
        "--across",
        action="append",
        choices=CROSSABLE,
        default=[],
        help="compare evaluations that differ in this condition; may be repeated",
    )
    parser.add_argument("--out", type=path, default=Path("report.html"), help="output file")


def run(args: argparse.Namespace) -> int:
    """Write the page and print the table; return the exit code."""
    page = render_report(args.folders, args.out, across=args.across, allow_version_mismatch=args.allow_version_mismatch)
    results = [read_results(folder) for folder in args.folders]
    print(results_table(results))
    for name in CROSSABLE:
        if any(name in unequal_conditions(a, b, args.across) for a, b in combinations(results, 2)):
            print(f"evaluations with different {name} are not paired; --across {name} pairs them")
    for a, b in combinations(results, 2):
        if not unequal_conditions(a, b, args.across) and len(apart := command_distances_cm(a, b)):
            loc, (low, high) = compare(a.rows, b.rows, "S_loc", allow_version_mismatch=True), bootstrap(apart)
            points = f"S_loc {100 * loc.difference:+.1f} [{100 * loc.low:+.1f}, {100 * loc.high:+.1f}] points"
            commands = f"commands {apart.mean():.2f} [{low:.2f}, {high:.2f}] cm apart"
            print(f"{a.folder} minus {b.folder}, {len(apart)} episodes: {points}, {commands}")
    print(f"report: {page}")
    return 0
