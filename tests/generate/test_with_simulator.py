from __future__ import annotations

import argparse
import json
from functools import partial

import pytest

from dynahoi_lerobot.generate import command, verify_command
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import Plan
from dynahoi_lerobot.generate.resimulate import simulator
from dynahoi_lerobot.generate.verify import verify
from dynahoi_lerobot.recipe import Recipe
from dynahoi_lerobot.rollout import record


def run(module, *words) -> int:
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    return module.run(parser.parse_args([str(word) for word in words]))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    root = tmp_path_factory.mktemp("simulated") / "d"
    words = ("--root", root, "--episodes", 2, "--image-size", 32, "--motions", "constant,lob")
    assert run(command, *words) == 0
    return root


def test_simulated_episodes_are_sound_and_replay(simulated, capsys):
    assert run(verify_command, simulated, "--replay", 2, "--decode", "all") == 0
    assert "2 episodes, all sound" in capsys.readouterr().out


def test_broken_dataset_is_reported(simulated, tmp_path, capsys):
    path = simulated / "meta/stats.json"
    before = path.read_text()
    path.write_text(before.replace('"min"', '"max"', 1))
    report = tmp_path / "findings.json"
    assert run(verify_command, simulated, "--json", report) == 1
    path.write_text(before)
    assert {"files", "statistics"} == {finding["check"] for finding in json.loads(report.read_text())}
    assert "meta/stats.json has changed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [(["nowhere"], "holds no LeRobot dataset"), (["nowhere", "--decode", "-1"], "--decode is '-1'")],
)
def test_bad_input_is_one_sentence(words, sentence, capsys):
    assert run(verify_command, *words) == 2
    assert sentence in capsys.readouterr().err


def test_edited_actions_do_not_replay(tmp_path):
    recipe = Recipe(motions=("constant",))
    plan = Plan(recipe, 1, camera=False)
    generate(plan, tmp_path / "d", record=partial(record, images=False))
    replay = simulator(plan.identity()["recipe"], images=False)

    def edited(meta, actions):
        actions = actions.copy()
        actions[meta.window_frames + 3, 0] += 0.01
        return replay(meta, actions)

    assert verify(tmp_path / "d", resimulate=replay) == []
    (finding,) = verify(tmp_path / "d", resimulate=edited)
    assert "replays to other states from frame" in finding.message
