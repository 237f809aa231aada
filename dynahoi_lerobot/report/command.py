"""``dynahoi report``: result folders as one HTML page."""

from __future__ import annotations

import argparse
from pathlib import Path

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.evaluate.table import results_table
from dynahoi_lerobot.report.entries import read_entries
from dynahoi_lerobot.report.page import write_page
from dynahoi_lerobot.sampling.benchmark import ALLOW_MISMATCH


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi report``."""
    parser.add_argument("folders", type=path, nargs="+", help="result folders of `dynahoi evaluate`")
    parser.add_argument(ALLOW_MISMATCH, action="store_true", help="accept results of different benchmark versions")
    parser.add_argument("--out", type=path, default=Path("report.html"), help="output file")


def run(args: argparse.Namespace) -> int:
    """Write the page and print the tables; return the exit code."""
    entries = read_entries(args.folders, allow_version_mismatch=args.allow_version_mismatch)
    page = write_page(entries, args.out)
    print(results_table([entry.results for entry in entries]))
    print(f"report: {page}")
    return 0
