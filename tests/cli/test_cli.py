"""The commands: what they print, and one clear sentence with a non-zero exit for bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.cli.listing import LISTS
from dynahoi_lerobot.evaluate.results import read_results


@pytest.mark.parametrize("what", sorted(LISTS))
def test_list_prints_every_entry_with_a_description(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list", what, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows
    assert all(str(value) for row in rows for key, value in row.items() if key in ("description", "ranges"))
    assert cli.main(["list", what]) == 0
    table = capsys.readouterr().out.splitlines()
    assert len(table) == len(rows) + 2
    assert len({len(line) for line in table}) == 1, "columns are aligned"


@pytest.mark.slow
def test_evaluate_writes_results_and_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "expert"
    words = ["evaluate", "--policy", "expert", "--out", str(out), "--image-size", "32"]
    assert cli.main([*words, "--episodes", "3", "--gifs", "1"]) == 0
    first = read_results(out)
    assert cli.main([*words, "--episodes", "5", "--per-kind"]) == 0
    results = read_results(out)
    assert [row["seed"] for row in results.rows[:3]] == [row["seed"] for row in first.rows]
    assert sorted(row["seed"] for row in results.rows) == [0, 1, 2, 3, 4]
    assert results.summary()["S_loc"].value == 1.0
    assert "S_loc %" in capsys.readouterr().out
    assert cli.main([*words, "--split", "val", "--episodes", "5"]) == cli.BAD_INPUT
    assert "another run (other split" in capsys.readouterr().err
    (gif,) = out.glob("*.gif")
    assert Image.open(gif).n_frames > 5, "equal neighbours are stored once"  # type: ignore[attr-defined]
    page = tmp_path / "page.html"
    assert cli.main(["report", str(out), "--out", str(page)]) == 0
    assert "expert" in page.read_text()


def test_an_evaluated_episode_is_shown_from_its_results(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out, shown = tmp_path / "r", {}
    words = ["--policy", "constant_velocity", "--motions", "planar,constant", "--episodes", "3"]
    assert cli.main(["evaluate", *words, "--out", str(out)]) == 0
    stage = next(row["stage"] for row in read_results(out).rows if row["seed"] == 1)
    for view in ("ego", "side"):
        film = tmp_path / f"{view}.gif"
        words = ["--seed", "1", "--image-size", "32", "--view", view, "--out", str(film)]
        assert cli.main(["view", "--results", str(out), *words]) == 0
        assert f"{stage}: {film}" in capsys.readouterr().out
        shown[view] = film.read_bytes()
    assert shown["side"] != shown["ego"]
    assert cli.main(["view", "--results", str(out), "--seed", "7", "--out", str(film)]) == 2
    assert "has no episode with seed 7; it has 0 to 2" in capsys.readouterr().err
