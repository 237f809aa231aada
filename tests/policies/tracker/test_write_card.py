"""The model card of a checkpoint: every figure is read from results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig
from lerobot_policy_tracker.learner import ON_POLICY
from lerobot_policy_tracker.write_card import DEFAULT_RULES, card_with_results, main
from tracker_helpers import make_policy

METRICS = {
    "S_loc": {"value": 0.625, "low": 0.5, "high": 0.75, "unit": "fraction", "n": 110},
    "E_loc": {"value": 0.346, "low": 0.31, "high": 0.38, "unit": "u", "n": 68},
    "S_hold": {"value": None, "low": None, "high": None, "unit": "fraction", "n": 0},
}
HEAD = {"n": 110, "split": "test_small", "policy": "p", "capture": "attach", "metrics": METRICS, "per_kind": {}}
HEAD |= {"fingerprint": "abc123", "command": "dynahoi evaluate --policy p --out r"}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    make_policy(ema_decay=0.9).save_pretrained(tmp_path / "catcher")
    return tmp_path / "catcher"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "metrics.json").write_text(json.dumps(HEAD))
    return tmp_path / "results"


def test_figures_come_from_the_results(checkpoint: Path, results: Path) -> None:
    assert main([str(checkpoint), str(results)]) == 0
    card = (checkpoint / "README.md").read_text()
    assert "## Results on `test_small`, 110 episodes, capture rule `attach`" in card
    assert "| S_loc | 62.50 | [50.00, 75.00] | % | 110 |" in card
    assert "| E_loc | 0.35 | [0.31, 0.38] | u | 68 |" in card
    assert "S_hold" not in card  # no episode meets its condition
    assert "fingerprint `abc123`" in card


def test_the_card_names_what_exists(checkpoint: Path, results: Path) -> None:
    card = card_with_results(checkpoint, [results])
    assert "--env.type=dynahoi" in card
    assert f"--policy.path={checkpoint.as_posix()}" in card
    assert "not recorded" in card
    assert not re.search(r"<\w+>", card)
    n_parameters = sum(p.numel() for p in make_policy().model.parameters())
    assert f"| Parameters | {n_parameters / 1e6:.2f} M |" in card


def test_commands_evaluate_under_the_rules_of_the_results(checkpoint: Path, results: Path) -> None:
    recipe = {"capture": "contact", "control_class": "late", "protocol": "observe_before_act"}
    (results / "metrics.json").write_text(json.dumps(HEAD | {"extra": {"recipe": recipe}}))
    card = card_with_results(checkpoint, [results])
    assert "--env.capture=contact --env.control_class=late --eval.n_episodes=5" in card
    assert "--split test_small --capture contact --control-class late --out results" in card
    assert "--env.protocol" not in card


def test_rules_that_go_unsaid_are_those_of_the_env() -> None:
    assert {name: getattr(DynahoiEnvConfig(), name) for name in DEFAULT_RULES} == DEFAULT_RULES


def test_the_dataset_is_named_when_it_is_known(checkpoint: Path, results: Path) -> None:
    (checkpoint / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": "me/catches"}}))
    card = card_with_results(checkpoint, [results])
    assert "datasets: [me/catches]" in card
    assert "| Training dataset | `me/catches` |" in card


def test_a_policy_that_learned_from_its_own_episodes_names_no_dataset_of_the_hub(
    checkpoint: Path, results: Path
) -> None:
    (checkpoint / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": ON_POLICY}}))
    card = card_with_results(checkpoint, [results])
    assert "datasets:" not in card
    assert "| Training dataset | `on-policy` |" in card


def test_every_results_folder_has_its_table(checkpoint: Path, results: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "metrics.json").write_text(json.dumps(HEAD | {"split": "ood_speed", "n": 7}))
    card = card_with_results(checkpoint, [results, tmp_path / "other"])
    assert "on `test_small`, 110 episodes" in card
    assert "on `ood_speed`, 7 episodes" in card


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(None, "metrics.json is missing"), ("{", "is damaged"), ("[]", "is damaged"), ('{"n": 3}', "KeyError")],
)
def test_bad_results_give_one_sentence_and_no_card(
    checkpoint: Path, tmp_path: Path, content: str | None, sentence: str, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "bad").mkdir()
    if content is not None:
        (tmp_path / "bad" / "metrics.json").write_text(content)
    assert main([str(checkpoint), str(tmp_path / "bad")]) == 1
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (checkpoint / "README.md").exists()


def test_a_folder_without_checkpoint_is_named(results: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([str(results), str(results)]) == 1
    assert f"{results} is no checkpoint: config.json is missing" in capsys.readouterr().err
