"""A result is certified if its logged commands lead to it, and only then."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.certify import sample
from dynahoi_lerobot.evaluate.results import read_results
from tests.evaluate.forgeries import FORGERIES


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes of a baseline that catches some."""
    folder = tmp_path_factory.mktemp("honest") / "results"
    assert main(["evaluate", "--policy", "constant_velocity", "--episodes", "3", "--out", str(folder)]) == 0
    return folder


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
