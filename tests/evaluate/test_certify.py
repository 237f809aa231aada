"""A result is certified if its logged commands lead to it, and only then."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate import result_files
from dynahoi_lerobot.evaluate.certify import sample
from dynahoi_lerobot.evaluate.results import Results, read_results


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes of a baseline that catches some."""
    folder = tmp_path_factory.mktemp("honest") / "results"
    assert main(["evaluate", "--policy", "constant_velocity", "--episodes", "3", "--out", str(folder)]) == 0
    return folder


def rewritten(folder: Path, **changes: object) -> None:
    """Write results again with other contents, its sums made to fit."""
    results: Results = replace(read_results(folder), **changes)
    result_files.write(folder, results.as_json(), results.rows, results.actions)


def edited_head(folder: Path, **changes: object) -> None:
    head = json.loads((folder / "metrics.json").read_text())
    (folder / "metrics.json").write_text(json.dumps(head | changes))


def better_sum(folder: Path) -> None:
    head = json.loads((folder / "metrics.json").read_text())
    head["metrics"]["S_loc"]["value"] = 99.0
    edited_head(folder, metrics=head["metrics"])


def better_row(folder: Path) -> None:
    rows = read_results(folder).rows
    rewritten(folder, rows=(rows[0] | {"E_loc": rows[0]["E_loc"] + 0.01}, *rows[1:]))


def another_log(folder: Path) -> None:
    actions = read_results(folder).actions
    moved = actions[1].copy()
    moved[-20:, :3] += 0.01
    rewritten(folder, actions=(actions[0], moved, actions[2]))


def faster_hand(folder: Path) -> None:
    actions = read_results(folder).actions
    leap = actions[2].copy()
    leap[-1, :3] += 1.0
    rewritten(folder, actions=(*actions[:2], leap))


def easy_seed_twice(folder: Path) -> None:
    results = read_results(folder)
    rewritten(folder, rows=(results.rows[0],) * 2, actions=(results.actions[0],) * 2)


FORGERIES: list[tuple[Callable[[Path], None], str]] = [
    (better_sum, "S_loc is 99.0 in metrics.json and "),
    (better_row, "seed {0}: E_loc is "),
    (another_log, "seed {1}: "),
    (faster_hand, "seed {2}: the command of frame "),
    (easy_seed_twice, "seed {0} is there 2 times"),
    (lambda folder: edited_head(folder, fingerprint="f"), "made by other code or another recipe (f, here is "),
    (lambda folder: edited_head(folder, split="val"), "names split val and capture rule attach, but its recipe plays"),
]
"""What is done to a result, and what is found; ``{i}`` stands for the seed of row i."""


def test_an_honest_result_is_certified(honest: Path, capsys: pytest.CaptureFixture):
    assert main(["certify", str(honest)]) == 0
    assert "certified: 3 of 110 episodes of test_small, 3 of them played again" in capsys.readouterr().out
    assert main(["certify", str(honest), "--episodes", "1"]) == 0
    assert "1 of them played again" in capsys.readouterr().out


def test_the_log_of_commands_is_read_once(honest: Path, monkeypatch: pytest.MonkeyPatch):
    load, opened = np.load, []

    def counted(path: Path, **options: Any) -> Any:
        opened.append(path)
        return load(path, **options)

    monkeypatch.setattr(np, "load", counted)
    assert main(["certify", str(honest), "--episodes", "1"]) == 0
    assert opened.count(honest / "actions.npz") == 1


@pytest.mark.parametrize(("forge", "finding"), FORGERIES)
def test_a_forged_result_is_not_certified(
    honest: Path, tmp_path: Path, forge: Callable[[Path], None], finding: str, capsys: pytest.CaptureFixture
):
    folder = tmp_path / "forged"
    shutil.copytree(honest, folder)
    forge(folder)
    assert main(["certify", str(folder)]) == 1
    said = capsys.readouterr().out
    assert finding.format(*(row["seed"] for row in read_results(honest).rows)) in said
    assert "not certified" in said


def test_results_of_a_salt_are_certified_by_who_knows_it(tmp_path: Path, capsys: pytest.CaptureFixture):
    secret, folder = "a secret of sixteen letters", str(tmp_path / "results")
    assert main(["evaluate", "--policy", "hold", "--episodes", "2", "--salt", secret, "--out", folder]) == 0
    assert main(["certify", folder, "--salt", secret]) == 0
    capsys.readouterr()
    for salt in ("", "another one of sixteen letters"):
        assert main(["certify", folder, "--salt", salt]) == 2
        said = capsys.readouterr().err
        assert "the results are of salt sha256:" in said
        assert secret not in said


def test_a_sample_is_spread_evenly():
    assert sample(10, None) == list(range(10))
    assert sample(10, 3) == [0, 4, 9]
    assert sample(2, 5) == [0, 1]
    assert len(np.unique(sample(1000, 44))) == 44
