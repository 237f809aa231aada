"""What policies read of the target besides images: the simulator's truth, or where the eye sees it,
on request.
"""

import json
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.report.entries import unique_labels
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.checkpoints import tiny_act
from tests.env.test_lerobot_plugin import through_lerobot
from tests.tools import dynahoi, generated

ENV = "dynahoi_lerobot.env:dynahoi/constant-v0"
KEY = "observation.environment_state"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    words = ["--environment-state", "truth", "--image-size", "0", "--motions", "constant,lob"]
    return generated(tmp_path_factory.mktemp("data") / "d", *words)


def small_act(folder: Path, size: int) -> str:
    ours = PolicyFeature(FeatureType.ENV, (size,))
    state = PolicyFeature(FeatureType.STATE, (18,))
    return str(tiny_act(folder, {KEY: ours, "observation.state": state}))


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> str:
    return small_act(tmp_path_factory.mktemp("act"), 13)


@pytest.fixture(scope="module")
def by_eye(tmp_path_factory: pytest.TempPathFactory) -> Path:
    words = ["--environment-state", "eye", "--image-size", "96", "--motions", "constant"]
    return generated(tmp_path_factory.mktemp("by_eye") / "d", *words)


def meaning(root: Path) -> str:
    """Return what the card of a dataset says about the column."""
    (row,) = [
        line
        for line in (root / "README.md").read_text().splitlines()
        if line.startswith(f"| `{KEY}` |")
    ]
    return row


def test_a_dataset_holds_it_on_request_and_lerobot_reads_it(data: Path) -> None:
    dataset = LeRobotDataset("local/d", root=data, delta_timestamps={KEY: [-0.05, 0.0]})
    (first, _) = read_episodes(data)
    expected = np.concatenate([first.target_pose_h, first.target_velocity_w], axis=1)
    np.testing.assert_array_equal(dataset[3][KEY], expected[2:4])
    assert dataset.meta.features[KEY]["names"][:4] == ["x", "y", "z", "qw"]
    assert set(dataset.meta.stats[KEY]) >= {"mean", "std", "min", "max"}
    dynahoi("verify", data)
    assert "true state of the target" in meaning(data)


def test_an_environment_shows_it_on_request() -> None:
    options = {"image_size": 0}
    env = gym.make(ENV, environment_state="truth", **options)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    batch = env.unwrapped._vector._batch
    truth = np.concatenate([batch.target_pose_h[0], batch.target_velocity_w[0]])
    np.testing.assert_allclose(observation["environment_state"], truth, atol=1e-6)
    blind = gym.make("dynahoi_lerobot.env:dynahoi/constant-v0", **options)
    assert "environment_state" not in blind.reset(seed=0)[0]
    assert "environment_state" not in blind.observation_space.spaces


def test_a_policy_that_reads_it_is_evaluated_on_request_and_marked(checkpoint, tmp_path, capsys):
    words = ["evaluate", "--policy", checkpoint, "--motions", "constant", "--episodes", "1"]
    words += ["--out", tmp_path / "r"]
    dynahoi(*words, code=2)
    assert "add --environment-state truth" in capsys.readouterr().err
    dynahoi(*words, "--environment-state", "truth")
    out = capsys.readouterr().out
    assert f"{checkpoint}*" in out
    assert "* privileged" in out
    results = read_results(tmp_path / "r")
    assert len(results.rows) == 1
    assert unique_labels([results])[0].endswith("(privileged)")
    assert results.privileged
    words = ["--actor", checkpoint, "--episodes", "1", "--root", tmp_path / "d"]
    dynahoi("generate", *words, code=2)
    assert f"reads {KEY}; an actor sees images and the hand alone" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


def test_lerobot_evaluates_it(checkpoint: str, tmp_path: Path) -> None:
    words = ("--env.environment_state=truth", "--eval.n_episodes=1", "--eval.batch_size=1")
    results = through_lerobot(Path(checkpoint), tmp_path, *words)
    assert (len(results.rows), results.privileged) == (1, True)


# -- what the eye sees -----------------------------------------------------------------------------


def test_a_dataset_holds_where_the_eye_saw_the_target(by_eye: Path) -> None:
    dynahoi("verify", by_eye)
    assert "where the eye" in meaning(by_eye)
    dataset = LeRobotDataset("local/d", root=by_eye)
    episodes = list(read_episodes(by_eye))
    np.testing.assert_array_equal(dataset[3][KEY], episodes[0].sighting[3])
    for episode in episodes:
        seen = episode.sighting
        acting = slice(episode.meta.window_frames, episode.first_localized)
        error_m = np.linalg.norm(seen[acting, :3] - episode.target_pose_h[acting, :3], axis=1)
        assert np.median(error_m) < 0.1
        across, along = np.median(seen[acting, 12:], axis=0)
        assert across < along, "one image tells directions better than distances"
        for at, age in enumerate((2, 4, 8), start=1):
            np.testing.assert_array_equal(seen[age:, 3 * at : 3 * at + 3], seen[:-age, :3])
            np.testing.assert_array_equal(
                seen[:age, 3 * at : 3 * at + 3], np.tile(seen[0, :3], (age, 1))
            )


def test_an_environment_shows_where_the_eye_sees_it() -> None:
    env = gym.make(ENV, environment_state="eye", image_size=96)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    np.testing.assert_array_equal(
        observation["environment_state"], env.unwrapped._vector._batch.observe().sighting[0]
    )
    moved, *_ = env.step(env.action_space.sample())
    np.testing.assert_array_equal(
        moved["environment_state"][3:6], observation["environment_state"][:3]
    )
    assert not np.array_equal(moved["environment_state"][:3], observation["environment_state"][:3])


def test_what_is_seen_in_a_world_depends_on_no_other_and_not_on_what_is_shown() -> None:
    recipe = Recipe.of(split="val", image_size=96, environment_state="eye")
    specs = sample_specs(recipe, range(3))
    alone = WorldBatch(replace(recipe.rules, image_size=0), 1)
    together = WorldBatch(recipe.rules, 2)
    together.reset([0, 1], specs[:2])
    together.observe()
    together.step(together.given)
    together.reset([1], specs[2:])
    alone.reset([0], specs[2:])
    first = together.observe(images=False).sighting
    assert not together.observe(images=False).images
    assert not alone.observe().images
    np.testing.assert_array_equal(first[1], alone.observe().sighting[0])
    np.testing.assert_array_equal(
        together.observe().sighting, first, "a frame may be observed twice"
    )


def test_a_policy_that_reads_it_is_not_privileged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reader = small_act(tmp_path / "act", 14)
    words = ["evaluate", "--policy", reader, "--motions", "constant", "--episodes", "1"]
    words += ["--out", tmp_path / "r"]
    dynahoi(*words, code=2)
    assert "does not say which" in capsys.readouterr().err
    env = {"type": "dynahoi", "environment_state": "eye", "image_size": 96}
    (tmp_path / "act" / "train_config.json").write_text(json.dumps({"env": env}))
    dynahoi(*words)
    assert "--environment-state eye" in capsys.readouterr().out
    results = read_results(tmp_path / "r")
    rules = results.recipe().rules
    assert (rules.environment_state, rules.image_size, results.privileged) == ("eye", 96, False)
    dynahoi(*words, "--environment-state", "truth", code=2)
    assert f"but {reader} needs --environment-state eye" in capsys.readouterr().err
