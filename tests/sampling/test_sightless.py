"""No way around the pictures: what else a policy sees tells neither where nor when the target is met."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "sightless.py"
EXPLAINED = 0.15
"""Share of the variance of point and time that is chance or the length of the window, at most; the home explains more
of each (0.26 to 0.48 of 1,000 episodes)."""


@pytest.mark.slow
def test_a_regressor_without_pictures_is_no_better_than_a_fixed_path(tmp_path: Path):
    command = [sys.executable, str(SCRIPT), "--train", "440", "--episodes", "220", "--json", "numbers.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    table = json.loads((tmp_path / "numbers.json").read_text())["table"]
    fixed = table["blind_path"]
    for inputs in ("numbers", "numbers and words"):
        row = table[f"regressor, {inputs}"]
        assert row["value"] <= fixed["high"]
        assert max(row["R2"]) <= EXPLAINED, inputs
    assert table["paths by motion"]["value"] <= fixed["high"]
    assert min(table["regressor, numbers and home"]["R2"]) > EXPLAINED, "the regressor would find what there is"
