"""Rounds through datasets on disk: their order, what each step is given, and going on after a kill at any of them."""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path

import pytest

from recipes.train import dagger_rounds
from tests.dataset.episodes import write
from tests.onpolicy.test_dagger import tiny_recipe

STEPS = [(0, "generate"), (0, "merge"), (0, "train"), (1, "generate"), (1, "merge"), (1, "train"), (1, "evaluate")]


class Commands:
    """Stands in for the commands that the rounds run; the one of a number is killed half way."""

    def __init__(self, killed: int = -1) -> None:
        self.called: list[dict[str, str]] = []
        self._killed = killed

    def dynahoi(self, command: str, *words: str) -> None:
        options = dict(zip(words[::2], words[1::2], strict=True))
        self._call(command, options)
        if command == "generate":
            write(Path(options["--root"]), range(int(options["--seed"]), int(options["--seed"]) + 2))

    def run(self, command: list[str], log: Path) -> None:
        options = dict(word.split("=", 1) for word in command[3:])
        self._call("train", options)
        folder = log.parent / "training" / "checkpoints" / f"{int(options['--steps']):06d}" / "pretrained_model"
        folder.mkdir(parents=True)
        (folder / "train_config.json").touch()

    def _call(self, name: str, options: dict[str, str]) -> None:
        self.called.append({"command": name} | options)
        if len(self.called) - 1 == self._killed:
            raise KeyboardInterrupt


def play(commands: Commands, recipe: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, str]]:
    """Run the script with the commands replaced; return the steps in its log."""
    monkeypatch.setattr(dagger_rounds, "dynahoi", commands.dynahoi)
    monkeypatch.setattr(dagger_rounds, "run", commands.run)
    monkeypatch.setattr(sys, "argv", ["dagger_rounds", str(recipe), "--out", str(out)])
    dagger_rounds.main()
    return [(line["round"], line["step"]) for line in map(json.loads, (out / "log.jsonl").read_text().splitlines())]


def test_each_round_learns_from_all_before_it_and_goes_on_from_the_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    recipe, out, commands = tiny_recipe(tmp_path, rounds=2), tmp_path / "out", Commands()
    assert play(commands, recipe, out, monkeypatch) == STEPS
    first, trained, second, resumed, evaluated = commands.called
    assert (first["--teacher-share"], second["--teacher-share"]) == ("1", "0.15")
    assert "--actor" not in first
    checkpoints = [str(out / "training" / "checkpoints" / f"{steps:06d}" / "pretrained_model") for steps in (2, 4)]
    assert second["--actor"] == checkpoints[0]
    assert (first["--seed"], second["--seed"]) == ("0", "2")
    assert "--resume" not in trained
    assert resumed["--resume"] == "true"
    assert resumed["--config_path"] == f"{checkpoints[0]}/train_config.json"
    assert resumed["--dataset.root"] == str(out / "data-0-1")
    info = json.loads((out / "data-0-1" / "meta" / "info.json").read_text())
    assert info["total_episodes"] == 4
    assert evaluated["--policy"] == checkpoints[1]


@pytest.mark.parametrize("killed", range(5))
def test_it_goes_on_after_a_kill_at_any_command(killed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recipe, out, commands = tiny_recipe(tmp_path, rounds=2), tmp_path / "out", Commands(killed)
    with pytest.raises(KeyboardInterrupt):
        play(commands, recipe, out, monkeypatch)
    with (out / "log.jsonl").open("a") as log:
        log.write('{"round": 0, "st')  # cut off
    assert play(commands, recipe, out, monkeypatch) == STEPS
    names = Counter(call["command"] for call in commands.called)
    assert sum(names.values()) == 6, "only the command that was killed is run again"


def test_kinds_that_fail_are_played_more_often():
    kinds = ["lob", "struck", "planar", "bounce"]
    played = ["lob"] * 8 + ["struck"] * 8 + ["planar"] * 8
    caught = [False] * 8 + [True] * 16
    shares = Counter(dagger_rounds.allotted(kinds, played, caught))
    assert shares["lob"] == 2
    assert shares["bounce"] == 1, "nothing is known of it"
    assert shares.total() == len(kinds)
    assert dagger_rounds.allotted(kinds, [], []) == kinds
