"""Every benchmark runs, in a tiny setting, as its first line says, and leaves its numbers in a file."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SCRIPTS = [pytest.param(path, id=path.stem, marks=pytest.mark.slow) for path in sorted(BENCHMARKS.glob("*.py"))]


def numbers_in(value: Any) -> Iterator[float]:
    """Yield every number of nested tables."""
    if isinstance(value, dict):
        for item in value.values():
            yield from numbers_in(item)
    elif isinstance(value, list):
        for item in value:
            yield from numbers_in(item)
    elif isinstance(value, int | float):
        yield value


@pytest.mark.parametrize("script", SCRIPTS)
def test_it_runs_and_writes_its_numbers(script: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(script), "--tiny", "--json", "out/numbers.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    table = json.loads((tmp_path / "out" / "numbers.json").read_text())
    assert table.pop("settings")
    assert table.pop("machine")["cores"] >= 1
    if script.stem == "contact_sheet":
        assert list(tmp_path.rglob("*.jpg"))
        assert len(table["kinds"]) == 2
        return
    numbers = list(numbers_in(table))
    assert numbers
    assert all(math.isfinite(number) for number in numbers)
    assert any(number > 0 for number in numbers)


@pytest.mark.slow
def test_an_eye_is_tested_on_what_a_policy_sees(tmp_path: Path) -> None:
    checkpoint = BENCHMARKS.parent / "checkpoints" / "tracker_standard"
    command = [
        sys.executable,
        str(BENCHMARKS / "eye.py"),
        "--tiny",
        "--visited-by",
        str(checkpoint),
        "--json",
        "n.json",
    ]
    subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)
    rows = json.loads((tmp_path / "n.json").read_text())["rows"]
    assert 10 < sum(row["pictures"] for row in rows) < 60, "two episodes, from the window to the meeting"


def test_a_place_that_cannot_hold_the_numbers_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    command = [sys.executable, str(BENCHMARKS / "pin.py"), "--tiny", "--json"]
    for place, sentence in (("file/numbers.json", "file is a file"), (".", "is a folder; name a file in it")):
        done = subprocess.run([*command, place], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert sentence in done.stderr.splitlines()[-1]
        assert not done.stdout
