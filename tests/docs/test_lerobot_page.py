"""Every row of the table of LeRobot's commands has a test that runs it, or says why it does not work."""

from __future__ import annotations

import ast
import re
from itertools import dropwhile, takewhile
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from tests.docs.documents import ROOT, Page

PAGE = Page.read(ROOT / "docs" / "lerobot.md")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def table() -> list[tuple[str, str, str, str]]:
    """Return (command, works, note, tests) of every row."""
    from_head = dropwhile(lambda line: not line.startswith("| LeRobot |"), PAGE.prose.splitlines())
    lines = takewhile(lambda line: line.startswith("|"), from_head)
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    head, _, *rows = cells
    assert head == ["LeRobot", "works", "note", "test"]
    return [(row[0], row[1], row[2], row[3]) for row in rows]


def test_the_table_covers_lerobots_commands():
    commands = " ".join(command for command, *_ in table())
    programs = (
        "lerobot-train",
        "lerobot-eval",
        "lerobot-edit-dataset",
        "lerobot-dataset-viz",
        "lerobot-info",
        "accelerate launch",
        "push_to_hub",
        "make_env",
    )
    assert not [name for name in programs if name not in commands]


@pytest.mark.parametrize("row", table(), ids=lambda row: row[0])
def test_a_row_that_works_has_a_test_and_one_that_does_not_a_reason(row: tuple[str, str, str, str]):
    _, works, note, tests = row
    assert works in ("yes", "in part", "no", "not tested")
    assert note or works == "yes"
    assert TEST.findall(tests) or works in ("no", "not tested")


@pytest.mark.parametrize(("path", "name"), sorted({found for *_, tests in table() for found in TEST.findall(tests)}))
def test_the_tests_named_are_there(path: str, name: str):
    tree = ast.parse((ROOT / path).read_text())
    assert name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    assert main(["generate", "--root", str(root), "--episodes", "2", "--image-size", "64"]) == 0
    return root


@pytest.mark.slow  # LeRobot takes long to import
@pytest.mark.parametrize("options", [("tracker", "--dataset.image_transforms.enable=true"), ("tdmpc",)], ids=" ".join)
def test_lerobot_trains_two_steps(options: tuple[str, ...], data: Path, tmp_path: Path):
    from tests.docs.playing import run

    policy, *more = options
    words = [f"--policy.type={policy}", "--policy.device=cpu", "--policy.push_to_hub=false", *more]
    words += ["--dataset.repo_id=local/d", f"--dataset.root={data}", f"--output_dir={tmp_path / 'out'}"]
    run(["lerobot-train", *words, "--steps=2", "--batch_size=2", "--num_workers=0", "--env_eval_freq=0"])
    assert (tmp_path / "out/checkpoints/last/pretrained_model/model.safetensors").is_file()
