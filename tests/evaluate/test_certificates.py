"""A certificate is of the exact bytes that were certified here, and nobody else can write it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate import certificates
from dynahoi_lerobot.evaluate.certificates import Certificate
from dynahoi_lerobot.report.entries import read_entries
from dynahoi_lerobot.report.tables import leaderboard
from tests.evaluate.forgeries import edited_head


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluated") / "results"
    assert main(["evaluate", "--policy", "constant_velocity", "--episodes", "3", "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def results(evaluated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Results that nobody has certified."""
    monkeypatch.setenv(certificates.HOME, str(tmp_path / "home"))
    return Path(shutil.copytree(evaluated, tmp_path / "results"))


def shown(folder: Path) -> str:
    """What the report's leaderboard says of the only evaluation in it."""
    table = leaderboard(read_entries([folder]))
    return table.rows[0][table.head.index("certified")].text


def test_the_report_shows_how_many_episodes_were_certified(results: Path, tmp_path: Path):
    assert shown(results) == "no"
    assert main(["certify", str(results), "--episodes", "2"]) == 0
    assert shown(results) == "2 of 3"
    assert main(["certify", str(results)]) == 0
    assert shown(results) == "all"
    assert main(["certify", str(results), "--episodes", "1"]) == 0
    assert shown(results) == "all", "less does not take more away"
    assert shown(Path(shutil.copytree(results, tmp_path / "copy"))) == "all", "the same bytes in another place"


def test_results_that_were_changed_afterwards_are_not_certified(results: Path):
    assert main(["certify", str(results)]) == 0
    edited_head(results, policy="mine")
    assert shown(results) == "no"


def test_results_that_fail_later_lose_their_certificate(results: Path):
    edited_head(results, fingerprint="0123456789abcdef")
    certificates.keep(results, Certificate(3, 3))
    assert main(["certify", str(results)]) == 1
    assert certificates.find(results) is None


def test_a_certificate_in_the_folder_itself_counts_for_nothing(results: Path):
    for name in ("certificate.json", "certificates/all.json"):
        path = results / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps({"episodes": 3, "replayed": 3}))
    assert shown(results) == "no"


def test_a_damaged_certificate_is_none(results: Path, tmp_path: Path):
    assert main(["certify", str(results)]) == 0
    (path,) = (tmp_path / "home" / "certificates").iterdir()
    for text in ("", "[]", '{"episodes": 3}', '{"episodes": null, "replayed": 3}'):
        path.write_text(text)
        assert shown(results) == "no"


def test_a_home_that_cannot_be_written_is_said(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    (tmp_path / "a file").touch()
    monkeypatch.setenv(certificates.HOME, str(tmp_path / "a file"))
    assert main(["certify", str(results)]) == 0
    said = capsys.readouterr().out
    assert "reports will not show it" in said
    assert "certified: 3 of 110 episodes" in said


def test_other_versions_are_named(results: Path, capsys: pytest.CaptureFixture):
    extra = json.loads((results / "metrics.json").read_text())["extra"]
    other = extra["surroundings"] | {"numpy": "1.0"}
    edited_head(results, fingerprint="0123456789abcdef", extra=extra | {"surroundings": other})
    assert main(["certify", str(results)]) == 1
    said = capsys.readouterr().out
    assert "other surroundings: numpy 1.0, not " in said
    assert "mujoco" not in said
