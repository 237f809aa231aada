"""No episode is there twice."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset, Columns


@CHECKS.register("duplicates")
class Duplicates(Check):
    """Checks that seeds and trajectories are unique."""

    def __init__(self) -> None:
        """Start without any known trajectory."""
        self._known: dict[bytes, int] = {}

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield repeated seeds."""
        known: dict[tuple[str, int], int] = {}
        for number, row in enumerate(dataset.rows):
            key = (row["split"], row["seed"])
            if key in known:
                yield f"episodes {known[key]} and {number} have the same seed, {row['seed']}"
            known.setdefault(key, number)

    def check_episode(self, dataset: CheckedDataset, row: EpisodeRow, columns: Columns) -> Iterator[str]:
        """Yield an episode whose trajectory was seen before."""
        digest = hashlib.sha256()
        for key in ("action", "observation.state", "target.pose"):
            digest.update(columns[key].tobytes())
        first = self._known.setdefault(digest.digest(), row["episode_index"])
        if first != row["episode_index"]:
            yield f"episodes {first} and {row['episode_index']} have the same trajectory"
