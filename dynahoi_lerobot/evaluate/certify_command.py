"""``dynahoi certify``: play the logged commands of a result folder again and compare every metric."""

from __future__ import annotations

import argparse

from tqdm import tqdm

from dynahoi_lerobot.evaluate import certificates
from dynahoi_lerobot.evaluate.certificates import Certificate
from dynahoi_lerobot.evaluate.certify import UNCERTIFIED, check_episodes, check_results, open_recipe, sample
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.foundation.arguments import path, whole
from dynahoi_lerobot.sampling.salt import add_salt_argument, split_of
from dynahoi_lerobot.sampling.splits import split_seeds

CERTIFIED, DIFFERS = 0, 1
SHOWN = 10
"""Findings that are printed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi certify``."""
    parser.add_argument("results", type=path, help="result folder of dynahoi evaluate")
    parser.add_argument("--episodes", type=whole(1, 10**6), help="play only so many, evenly spread; all by default")
    add_salt_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Print whether the results are certified, or what differs; return the exit code: 0 certified, 1 not.

    What is certified is kept for ``dynahoi report``, see `certificates`.

    Raises:
        ResultsError: if the folder cannot be read.
        ValueError: if the results are of another salt.
    """
    results = read_results(args.results)
    recipe = open_recipe(results, args.salt)
    findings = list(check_results(results, recipe))
    chosen = sample(len(results.rows), args.episodes)
    if not findings:
        progress = tqdm(check_episodes(results, recipe, chosen), total=len(chosen), desc="replaying", unit="episode")
        findings = [finding for found in progress for finding in found]
    for finding in findings[:SHOWN]:
        print(finding)
    if findings:
        print(f"not certified, {len(findings)} found")
        certificates.withdraw(results.folder)
        return DIFFERS
    try:
        certificates.keep(results.folder, Certificate(len(results.rows), len(chosen)))
    except OSError as error:
        print(f"reports will not show it, because the certificate cannot be kept: {error}")
    print(f"certified: {_scope(results, len(chosen))}\n{UNCERTIFIED}")
    return CERTIFIED


def _scope(results: Results, replayed: int) -> str:
    """What was confirmed, in one line."""
    whole_split = split_seeds(split_of(results.info.split))
    played = f"{len(results.rows)} of {len(whole_split)} episodes of {results.info.split}"
    return f"{played}, {replayed} of them played again, every metric the same"
