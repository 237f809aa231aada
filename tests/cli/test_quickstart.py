"""``dynahoi quickstart``, the first command that anyone runs: all of it, shortened."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from dynahoi_lerobot.cli import quickstart
from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.sampling.benchmark import MOTIONS

SHORT = ["--episodes", "4", "--rounds", "1", "--evaluation-episodes", "1"]


STANDARD = Path(__file__).parents[2] / "recipes" / "train" / "standard.yaml"
"""What the quickstart shortens; wheels hold only the copy."""


def test_it_trains_the_standard_recipe_shortened() -> None:
    copy, original = (yaml.safe_load(path.read_text()) for path in (quickstart.TRAINING, STANDARD))
    differs = {key for key in copy.keys() | original.keys() if copy.get(key) != original.get(key)}
    assert differs == {"out", "rounds", "validation_episodes"}


@pytest.mark.slow
def test_it_leaves_a_dataset_a_checkpoint_results_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "quickstart"
    assert main(["quickstart", "--out", str(out), *SHORT]) == 0, capsys.readouterr().err
    assert main(["verify", str(out / "dataset")]) == 0
    config = json.loads((out / "training/pretrained_model/config.json").read_text())
    assert config["type"] == "obact"
    kinds = sorted(MOTIONS)
    for name in ("obact", *quickstart.BASELINES):
        assert sorted(row["kind"] for row in read_results(out / "results" / name).rows) == kinds
    page = (out / "report.html").read_text()
    assert all(name in page for name in ("obact", *quickstart.BASELINES))
    assert "S_loc" in (out / "table.txt").read_text()

    capsys.readouterr()
    assert main(["quickstart", "--out", str(out), *SHORT]) == 0
    assert capsys.readouterr().out.count("already done") == 4, "a second run must find everything there"
