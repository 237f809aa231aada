"""Every option of every command, given what nobody should: one sentence and exit code 2, or it works. No traceback."""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.generate import pipeline

NUMBERS = ("-1", "0", "1e400", "nan", "-inf", str(10**30), "9" * 5000, "1e3", "", "0x10")
REQUIRED = {
    "generate": ["--root", "made", "--episodes", "1", "--image-size", "0", "--motions", "constant"],
    "verify": ["nothing"],
    "filter": ["nothing", "--out", "made"],
    "evaluate": ["--policy", "hold", "--motions", "constant", "--episodes", "1", "--image-size", "16"],
    "pretrain": ["--recipe", "nothing"],
    "report": ["nothing"],
    "view": ["--motion", "constant", "--image-size", "16", "--out", "made.gif"],
    "quickstart": ["--out", "file/made"],
    "list": ["hands"],
    "doctor": [],
}
"""Arguments with which a command would do little; what is tested is said after them and wins."""
PATHS = ("file/below", "dangling", "dangling/below", "~nobody-of-that-name/x", "x" * 300, "loop", "a\0b", "")


def options(command: str) -> Iterator[argparse.Action]:
    parser = argparse.ArgumentParser()
    importlib.import_module(cli.COMMANDS[command][0]).add_arguments(parser)
    yield from (action for action in parser._actions if action.option_strings and action.type not in (None, str))


def is_path(action: argparse.Action) -> bool:
    return action.dest in ("root", "out", "json", "recipe", "dataset", "results", "folder")


def cases(paths: bool) -> list:
    found = [(command, action) for command in cli.COMMANDS for action in options(command) if is_path(action) == paths]
    chosen = [(command, action) for command, action in found if action.dest not in NAMES]
    return [pytest.param(command, action, id=f"{command}{action.option_strings[0]}") for command, action in chosen]


NAMES = ("views", "appearance", "motions", "objects")
"""Lists of names, which no number and no path is."""


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An otherwise empty working folder with a file, a link to nothing and a link to itself; work stops at once."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("work was begun")

    monkeypatch.setattr(pipeline, "_make", refuse)
    return tmp_path


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"file", "dangling", "loop"}


def says_one_sentence(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(words) == cli.BAD_INPUT, words
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"dynahoi {words[0]}: ")
    assert "\n" not in said
    assert len(said) < 1000
    return said


def forms(number: str) -> list[str]:
    """Return what a message may call a value, or, of an option with two values, their number."""
    with suppress(ValueError):
        return [number[:20], str(float(number)), "expected 2 arguments"]
    return [number[:20]]


HARMLESS = {
    "generate --image-size": ("0",),
    "generate --seed": ("0",),
    "generate --crf": ("0",),
    "generate --perturbed-share": ("0",),
    "generate --render-noise": ("0",),
    "evaluate --image-size": ("0",),
    "view --render-noise": ("0",),
    "evaluate --render-noise": ("0",),
    "generate --video-seconds": ("1e3",),
    "generate --gpus-per-task": ("0",),
    "verify --replay": ("0",),
    "filter --drop": ("0", ""),
    "view --seed": ("0",),
    "view --episode": ("0",),
    "evaluate --gifs": ("0",),
    "evaluate --episodes": (str(10**30),),
    "evaluate --inference-ms": ("0",),
    "evaluate --prices": ("0", "1e3"),
    "evaluate --request-timeout": ("1e3",),
    "filter --margin": ("0", "1e3", str(10**30)),
}
"""Values out of ``NUMBERS`` that are right, by command and option."""
VLM = ["--policy", "vlm", "--model", "tiny", "--base-url", "http://127.0.0.1:9/v1"]
CLUSTER = ["--executor", "local", "--dry-run"]
ALONGSIDE = {
    "--prices": VLM,
    "--request-timeout": VLM,
    "--tasks": CLUSTER,
    "--cpus-per-task": CLUSTER,
    "--gpus-per-task": CLUSTER,
}
"""What an option is read with."""


@pytest.mark.parametrize(("command", "action"), cases(paths=False))
def test_no_number_breaks_a_command(
    command: str, action: argparse.Action, dataset: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    option = action.option_strings[0]
    words = [command, *REQUIRED[command], *ALONGSIDE.get(option, [])]
    if option == "--replay":
        words = [command]
    if option == "--episode":
        words = [command, "--dataset", "nothing", "--out", "made.gif"]
    words = [str(dataset) if word == "nothing" else word for word in words]
    for number in NUMBERS:
        if number in HARMLESS.get(f"{command} {option}", ()):
            continue
        begin = time.monotonic()
        given = [option, number, number] if action.nargs == 2 else [f"{option}={number}"]
        said = says_one_sentence([*words, *given], capsys)
        assert time.monotonic() - begin < 60, "nearly all of it is the first import of LeRobot"
        assert any(form in said for form in forms(number)), "the value received is named"
        assert not left(place), number


@pytest.mark.parametrize(("command", "action"), cases(paths=True))
def test_no_path_breaks_a_command(
    command: str, action: argparse.Action, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [] if action.dest not in ("dataset", "results") else ["--out", "made.gif"]
    words = [command, *(given or REQUIRED[command])]
    for path in PATHS:
        says_one_sentence([*words, f"{action.option_strings[0]}={path}"], capsys)
        assert not left(place), path
    assert (place / "file").read_text() == "mine"
