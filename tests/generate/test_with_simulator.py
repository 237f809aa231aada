from __future__ import annotations

import argparse
import dataclasses
import json

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from dynahoi_lerobot.core.conventions import FINGERS
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.dataset import open_dataset, read_episodes
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.generate import command
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.replay import simulator
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify import command as verify_command
from dynahoi_lerobot.verify.runner import verify


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
    assert "2 episodes, no findings" in capsys.readouterr().out


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
    [(["nowhere"], "is no LeRobot dataset"), (["nowhere", "--decode", "-1"], "--decode is '-1'")],
)
def test_bad_input_is_one_sentence(words, sentence, capsys):
    assert run(verify_command, *words) == 2
    assert sentence in capsys.readouterr().err


def test_a_replay_compares_what_the_expert_commands(tmp_path):
    recipe = Recipe(motions=("constant",), image_size=0)
    plan = GenerationPlan(recipe, 1)
    generate(plan, tmp_path / "d", record=record)
    replay = simulator(plan.identity()["recipe"])

    def edited(seed):
        episode = replay(seed)
        action = episode.action.copy()
        action[episode.meta.window_frames + 3, 0] += 0.01
        return dataclasses.replace(episode, action=action)

    assert verify(tmp_path / "d", replayed=1, resimulate=replay) == []
    (finding,) = verify(tmp_path / "d", replayed=1, resimulate=edited)
    assert "replays to another action from frame" in finding.message


def test_a_physical_dataset_holds_forces_and_replays(tmp_path, capsys):
    root = tmp_path / "contact"
    words = ("--root", root, "--episodes", 3, "--image-size", 32, "--motions", "constant,planar,struck")
    assert run(command, *words, "--capture", "contact") == 0
    assert run(verify_command, root, "--replay", 3, "--decode", "all") == 0
    assert "3 episodes, no findings" in capsys.readouterr().out
    dataset = LeRobotDataset("local/contact", root=root)
    assert dataset.meta.features[FEATURES["touch"].key]["names"] == list(FINGERS)
    touch = np.stack([dataset[i][FEATURES["touch"].key].numpy() for i in range(len(dataset))])
    assert touch.shape[1:] == (5,)
    assert (touch.max(axis=0) > 0.5).all(), "every finger has held something [N]"
    assert dataset.meta.stats[FEATURES["touch"].key]["max"].max() == pytest.approx(touch.max())
    rows = dataset.meta.episodes
    assert set(rows["capture"]) == {"contact"}
    assert set(rows["agent"]) == {"match"}
    assert set(rows["stage"]) == {"held"}


VIEWS = ("side", "ego_depth", "ego_segmentation")


@pytest.mark.parametrize("codec", ["h264", "images"])
def test_further_views_are_stored_read_and_replayed(tmp_path, codec):
    recipe = Recipe(motions=("constant", "struck"), image_size=48, views=VIEWS)
    plan = GenerationPlan(recipe, 2, encoding=Encoding(codec), shard_episodes=1)  # two shards, merged
    generate(plan, tmp_path / "d", record=record)
    assert verify(tmp_path / "d", decoded=None, replayed=2) == []
    for episode in read_episodes(tmp_path / "d"):
        assert list(episode.images) == ["ego", *VIEWS]
        assert len({images.shape for images in episode.images.values()}) == 1
        assert np.abs(episode.images["side"].astype(int) - episode.images["ego"]).mean() > 5
    item = open_dataset(tmp_path / "d")[30]
    assert all(item[f"observation.images.{view}"].shape == (3, 48, 48) for view in ("ego", *VIEWS))


def test_a_missing_view_is_named(tmp_path):
    generate(
        GenerationPlan(Recipe(motions=("constant",), image_size=16, views=("side",)), 1), tmp_path / "d", record=record
    )
    info = json.loads((path := tmp_path / "d" / "meta/info.json").read_text())
    del info["features"]["observation.images.side"]
    path.write_text(json.dumps(info))
    assert any("observation.images.side is missing" in str(finding) for finding in verify(tmp_path / "d"))
