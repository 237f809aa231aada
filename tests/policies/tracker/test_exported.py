"""The trained checkpoint that comes with the repository."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.results import read_results

CHECKPOINT = Path(__file__).parents[3] / "checkpoints" / "tracker_standard"


@pytest.mark.slow
def test_it_catches_pendulum_bobs_it_has_never_seen(tmp_path: Path) -> None:
    """Three of the first five on the machine that measured it; rounding elsewhere may cost one or two."""
    words = ["--policy", str(CHECKPOINT), "--motions", "planar", "--episodes", "5", "--out", str(tmp_path)]
    assert main(["evaluate", *words]) == 0
    rows = read_results(tmp_path).rows
    assert {row["kind"] for row in rows} == {"planar"}
    assert sum(row["S_loc"] for row in rows) >= 1
    assert sum(file.stat().st_size for file in CHECKPOINT.iterdir()) < 20e6
