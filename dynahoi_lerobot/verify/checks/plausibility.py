"""Every trajectory is one that a hand could move along."""

from __future__ import annotations

from collections.abc import Iterator

from dynahoi_lerobot.dataset.episode_table import Row
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, Columns, Evidence
from dynahoi_lerobot.verify.plausibility import implausibilities


@CHECKS.register("plausibility")
class Plausibility(Check):
    """Applies the rejection rules of generation to what is stored."""

    def episode(self, evidence: Evidence, row: Row, columns: Columns) -> Iterator[str]:
        """Yield what no sound recording shows."""
        yield from (f"episode {row['episode_index']}: {problem}" for problem in implausibilities(columns))
