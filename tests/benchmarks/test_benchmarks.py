"""Every benchmark runs, in a tiny setting, as its first line says, and leaves its numbers in a
file.
"""

import importlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
NAMES = sorted(
    path.stem for path in BENCHMARKS.glob("*.py") if path.stem not in ("behaviour", "tables")
)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Run a benchmark in an empty folder, in this process, which has imported most of what it
    needs.
    """
    monkeypatch.chdir(tmp_path)

    def run(name: str, *options: str) -> dict[str, Any]:
        monkeypatch.setattr(
            "sys.argv", [f"{name}.py", "--tiny", "--json", "out/numbers.json", *options]
        )
        importlib.import_module(name).main()
        return json.loads(
            Path("out/numbers.json").read_text(), parse_constant=pytest.fail
        )  # NaN, infinity

    return run


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_it_runs_and_writes_its_numbers(name: str, run: Callable[..., dict[str, Any]]) -> None:
    table = run(name)
    assert table.pop("settings")
    assert table.pop("machine")["cores"] >= 1
    assert all(table.pop(name) for name in ("command", "commit", "processor"))
    table.pop("benchmark", None)
    assert re.search(r"[: ][0-9.]*[1-9]", json.dumps(table)), "a number above 0"


@pytest.mark.nightly
@pytest.mark.slow
def test_an_eye_is_tested_on_what_a_policy_sees(run: Callable[..., dict[str, Any]]) -> None:
    checkpoint = BENCHMARKS.parent / "checkpoints" / "obact_standard"
    rows = run("eye", "--visited-by", str(checkpoint))["rows"]
    assert 10 < sum(row["images"] for row in rows) < 60, (
        "two episodes, from the window to the meeting"
    )


@pytest.mark.nightly
@pytest.mark.slow
def test_a_salt_doubles_the_episodes(run: Callable[..., dict[str, Any]]) -> None:
    (row,) = run("results", "--salt", "sixteen letters!")["runs"].values()
    assert row["metrics"]["S_loc"]["n"] == 4


@pytest.mark.parametrize("place", ["file/n.json", "."])
def test_a_place_that_cannot_hold_the_numbers_is_refused_before_the_work(place, run):
    Path("file").touch()
    with pytest.raises(SystemExit, match="2"):
        run("pin", "--json", place)


def test_a_row_may_play_the_policies_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["results.py", "--dry-run", "--only", "ObAct", "ObAct, late"])
    importlib.import_module("results").main()
    commands = capsys.readouterr().out.splitlines()
    for program in ("dynahoi generate", "dynahoi encode", "lerobot-train"):
        matching = [line for line in commands if line.startswith(program)]
        assert len(matching) == 4, "three seeds, and the first one again"
        assert matching[0] == matching[3]
    plain, *_, late = [line for line in commands if line.startswith("dynahoi evaluate")]
    assert plain.split(" --split")[0] == late.split(" --split")[0], "the same policy"
    assert plain.split("--out")[1] != late.split("--out")[1]
