"""verify: prove every promise about a dataset on disk, or say which one is broken."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from dynahoi_lerobot.verify.checks.base import CHECKS, Check, Evidence, Finding
from dynahoi_lerobot.verify.resimulation import Resimulate, replay

DECODED = 64
REPLAYED = 8
SHOWN = 5
"""A check that finds the same in every episode is cut short after so many."""


def verify(
    root: Path,
    *,
    decoded: int | None = DECODED,
    resimulate: Resimulate | None = None,
    replayed: int = REPLAYED,
    progress: Callable[[int], object] = lambda _: None,
) -> list[Finding]:
    """Check a dataset.

    Args:
        root: the dataset's folder.
        decoded: how many episodes' pictures are decoded, None for all. Every packet of every video is read anyway.
        resimulate: the simulator, for replaying stored actions; None leaves that out.
        replayed: how many episodes are replayed.
        progress: called with the number of episodes that are checked.

    Returns:
        What is broken; empty if nothing is.

    Raises:
        FileNotFoundError: if there is no dataset.
    """
    evidence = Evidence(root, decoded)
    checks = [(name, check()) for name, check in CHECKS.items()]
    findings = [finding for name, check in checks for finding in _guarded(name, check.dataset(evidence))]
    findings += _guarded("reading", _episodes(evidence, checks, progress))
    if resimulate is not None:
        findings += _guarded("replay", replay(evidence, resimulate, replayed))
    return list(_shortened(findings))


def _episodes(
    evidence: Evidence, checks: list[tuple[str, Check]], progress: Callable[[int], object]
) -> Iterator[Finding]:
    for number, (row, columns) in enumerate(evidence.each_episode(), 1):
        for name, check in checks:
            yield from _guarded(name, check.episode(evidence, row, columns))
        progress(number)


def _guarded(name: str, found: Iterator[str] | Iterator[Finding]) -> list[Finding]:
    """Collect what one check finds; what it trips over is a finding too, because a sound dataset trips nobody."""
    findings: list[Finding] = []
    try:
        findings.extend(item if isinstance(item, Finding) else Finding(name, item) for item in found)
    except Exception as error:
        findings.append(Finding(name, f"cannot be checked: {type(error).__name__}: {error}"))
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
