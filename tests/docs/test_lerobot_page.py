"""Every row of the table of LeRobot's commands has a test that runs it, or says why it does not work."""

from __future__ import annotations

import ast
import re
from itertools import dropwhile, takewhile

import pytest

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
        "push_to_hub",
        "make_env",
    )
    assert not [name for name in programs if name not in commands]


@pytest.mark.parametrize("row", table(), ids=lambda row: row[0])
def test_a_row_that_works_has_a_test_and_one_that_does_not_a_reason(row: tuple[str, str, str, str]):
    _, works, note, tests = row
    assert works in ("yes", "in part", "no")
    assert note or works == "yes"
    assert TEST.findall(tests) or works == "no"


@pytest.mark.parametrize(("path", "name"), sorted({found for *_, tests in table() for found in TEST.findall(tests)}))
def test_the_tests_named_are_there(path: str, name: str):
    tree = ast.parse((ROOT / path).read_text())
    assert name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
