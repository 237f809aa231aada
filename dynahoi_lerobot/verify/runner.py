"""Run every registered check on a dataset and collect the findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Finding
from dynahoi_lerobot.verify.readable import rewritten, unreadable
from dynahoi_lerobot.verify.replay_check import compare_replays

if TYPE_CHECKING:
    from dynahoi_lerobot.rollout.replay import Resimulate

DECODED = 64
"""Episodes whose pictures are decoded by default."""
SHOWN = 5
"""Findings reported per check; the rest are counted."""


def verify(
    root: Path,
    *,
    decoded: int | None = DECODED,
    replayed: int = 0,
    resimulate: Resimulate | None = None,
    progress: Callable[[int], object] = lambda _: None,
) -> list[Finding]:
    """Run every check on a dataset.

    Args:
        root: the dataset's folder.
        decoded: how many episodes' pictures are decoded, None for all. Every packet of every video is read anyway.
        replayed: how many episodes are made again from their seeds and compared.
        resimulate: makes the episode of a seed; by default the expert of the manifest's recipe.
        progress: called with the number of episodes checked so far.

    Returns:
        At most ``SHOWN`` findings per check and a count of the rest; empty if every check passed. If a table cannot be
        read, that alone; if another tool has rewritten the dataset, that, and what LeRobot's format finds wrong.

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
    """
    dataset = CheckedDataset(root, decoded)
    if (sentence := rewritten(root)) is not None:
        return [Finding("reading", sentence), *_shortened(_checked(dataset, progress, of_the_format=True))]
    if findings := _guarded("reading", unreadable(root)):
        return list(_shortened(findings))
    findings = _checked(dataset, progress)
    if replayed:
        findings += _guarded("replay", compare_replays(dataset, replayed, resimulate))
    return list(_shortened(findings))


def _checked(
    dataset: CheckedDataset, progress: Callable[[int], object], *, of_the_format: bool = False
) -> list[Finding]:
    """Run all checks, or those alone that LeRobot's format asks of any dataset."""
    checks = [(name, check()) for name, check in CHECKS.items() if check.of_the_format or not of_the_format]
    findings = [finding for name, check in checks for finding in _guarded(name, check.check_dataset(dataset))]
    return findings + _guarded("reading", _episodes(dataset, checks, progress))


def _episodes(
    dataset: CheckedDataset, checks: list[tuple[str, Check]], progress: Callable[[int], object]
) -> Iterator[Finding]:
    for number, (row, columns) in enumerate(dataset.each_episode(), 1):
        for name, check in checks:
            where = f"episode {row['episode_index']} "
            yield from _guarded(name, check.check_episode(dataset, row, columns), where)
        progress(number)


def _guarded(name: str, found: Iterator[str] | Iterator[Finding], where: str = "") -> list[Finding]:
    """Collect what one check finds; an exception in a check is a finding, too."""
    findings: list[Finding] = []
    try:
        findings.extend(item if isinstance(item, Finding) else Finding(name, item) for item in found)
    except Exception as error:
        findings.append(Finding(name, f"{where}cannot be checked: {type(error).__name__}: {error}"))
    return findings


def _shortened(findings: list[Finding]) -> Iterator[Finding]:
    counts: dict[str, int] = {}
    for finding in findings:
        counts[finding.check] = counts.get(finding.check, 0) + 1
        if counts[finding.check] <= SHOWN:
            yield finding
    for check, count in counts.items():
        if count > SHOWN:
            yield Finding(check, f"and {count - SHOWN} more")
