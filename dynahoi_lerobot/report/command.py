"""``dynahoi report``: result folders as one HTML page."""

import argparse
from itertools import combinations
from pathlib import Path

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.evaluate.compare import COMMANDS, CROSSABLE, compare, unequal_conditions
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.report.page import write_page
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
        help="also pair evaluations that differ in this condition; may be repeated",
    )
    parser.add_argument("--out", type=path, default=Path("report.html"), help="output file")


def run(args: argparse.Namespace) -> int:
    """Write the page and print the tables; return the exit code."""
    entries = read_entries(args.folders, allow_version_mismatch=args.allow_version_mismatch)
    page = write_page(entries, args.out, args.across)
    print(results_table([entry.results for entry in entries]))
    pairs = list(combinations(entries, 2))
    for name in CROSSABLE:
        if any(name in unequal_conditions(a.results, b.results, args.across) for a, b in pairs):
            print(f"evaluations with different {name} are not paired; --across {name} pairs them")
    for a, b in pairs if args.across else []:
        if not unequal_conditions(a.results, b.results, args.across):
            print(_difference(a, b, args.across))
    print(f"report: {page}")
    return 0


def _difference(a: Entry, b: Entry, across: list[str]) -> str:
    loc, apart = (
        compare(a.results, b.results, name, across=across, allow_version_mismatch=True) for name in ("S_loc", COMMANDS)
    )
    if loc is None or apart is None:
        return f"{a.label} and {b.label} share no episode"
    points = f"S_loc {100 * loc.difference:+.1f} [{100 * loc.low:+.1f}, {100 * loc.high:+.1f}] points"
    commands = f"commands {apart.difference:.2f} [{apart.low:.2f}, {apart.high:.2f}] cm apart"
    return f"{a.label} minus {b.label}, {loc.n} episodes: {points}, {commands}"
