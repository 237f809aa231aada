"""``dynahoi doctor``: check every part of this machine."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from dynahoi_lerobot.core.arguments import path
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.doctor.parts import Fact, examine
from dynahoi_lerobot.doctor.reference import compare

SOUND, PROBLEMS = 0, 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi doctor``."""
    parser.add_argument("--folder", type=path, default=Path(), help="output folder, whose disk is checked")
    parser.add_argument(
        "--reference", action="store_true", help="also play 44 episodes and compare them bit by bit with ours"
    )
    parser.add_argument("--json", type=path, help="also write the facts to this file")


def run(args: argparse.Namespace) -> int:
    """Print the findings; return the exit code: 0 without problems, 1 with problems.

    Raises:
        ValueError: if the folder or the file is not writable.
    """
    check_output(args.folder)
    if args.json:
        check_output(args.json)
    facts = []
    for fact in chain(examine(args.folder), compare() if args.reference else ()):
        print(_line(fact), flush=True)
        facts.append(fact)
    if args.json:
        args.json.write_text(json.dumps([asdict(fact) for fact in facts], indent=2) + "\n", encoding="utf-8")
    return _conclude(facts)


def _line(fact: Fact) -> str:
    mark = "PROBLEM: " if fact.problem else ""
    follows = f"  -> {fact.follows}" if fact.follows else ""
    return f"{fact.name:<24} {mark}{fact.found}{follows}"


def _conclude(facts: Sequence[Fact]) -> int:
    problems = [fact.name for fact in facts if fact.problem]
    print(f"problems: {', '.join(problems)}" if problems else "no problems")
    return PROBLEMS if problems else SOUND
