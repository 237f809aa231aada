"""Results replay if their logged commands lead to them, and only then."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.replay_results import drawn
from dynahoi_lerobot.evaluate.results import read_results
from tests.evaluate.forgeries import FORGERIES


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes of a baseline that catches some."""
    folder = tmp_path_factory.mktemp("honest") / "results"
    assert main(["evaluate", "--policy", "constant_velocity", "--episodes", "3", "--out", str(folder)]) == 0
    return folder


def test_an_honest_result_replays(honest: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["evaluate", "--replay", str(honest)]) == 0
    said = capsys.readouterr().out
    assert "3 episodes drawn" in said
    for name in ("metrics.json", "episodes.parquet", "actions.npz"):
        assert hashlib.sha256((honest / name).read_bytes()).hexdigest() in said
    assert said.count("not the benchmark's") == 1
    assert "not the benchmark's privileged: True" in said


def test_a_drawn_sample_can_be_drawn_again(honest: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["evaluate", "--replay", str(honest), "--episodes", "1"]) == 0
    (seed,) = re.findall(r"--replay-seed (\d+)", capsys.readouterr().out)
    assert main(["evaluate", "--replay", str(honest), "--episodes", "1", "--replay-seed", seed]) == 0
    assert f"1 episodes drawn with --replay-seed {seed}" in capsys.readouterr().out


def test_easier_rules_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = [
        "evaluate",
        "--policy",
        "hold",
        "--episodes",
        "2",
        "--out",
        str(tmp_path / "easy"),
        "--motions",
        "constant",
    ]
    assert main([*words, "--protocol", "direct_act"]) == 0
    capsys.readouterr()
    assert main(["evaluate", "--replay", str(tmp_path / "easy")]) == 0
    said = capsys.readouterr().out
    assert "not the benchmark's motions: ('constant',)" in said
    assert "not the benchmark's protocol: 'direct_act'" in said


@pytest.mark.parametrize(("forge", "finding"), FORGERIES)
def test_a_forged_result_is_found(
    honest: Path, tmp_path: Path, forge: Callable[[Path], None], finding: str, capsys: pytest.CaptureFixture
):
    folder = tmp_path / "forged"
    shutil.copytree(honest, folder)
    forge(folder)
    assert main(["evaluate", "--replay", str(folder)]) == 1
    said = capsys.readouterr().out
    assert finding.format(*(row["seed"] for row in read_results(honest).rows)) in said
    assert "not the same" in said


def test_results_of_a_salt_are_replayed_by_who_knows_it(tmp_path: Path, capsys: pytest.CaptureFixture):
    secret, folder = "a secret of sixteen letters", str(tmp_path / "results")
    assert main(["evaluate", "--policy", "hold", "--episodes", "2", "--salt", secret, "--out", folder]) == 0
    assert main(["evaluate", "--replay", folder, "--salt", secret]) == 0
    capsys.readouterr()
    for salt in ("", "another one of sixteen letters"):
        assert main(["evaluate", "--replay", folder, "--salt", salt]) == 2
        said = capsys.readouterr().err
        assert "the results are of salt sha256:" in said
        assert secret not in said


def test_samples_are_without_repetition_and_of_the_seed():
    assert drawn(10, None, 0) == list(range(10))
    assert drawn(2, 5, 0) == [0, 1]
    assert len(set(drawn(1000, 44, 0))) == 44
    assert drawn(1000, 44, 0) == drawn(1000, 44, 0) != drawn(1000, 44, 1)
