"""`dynahoi generate --actor`: a policy moves the hand, the expert labels every frame; the dataset is as any other."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset import frame_column, read_episodes
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent, PolicyError
from dynahoi_lerobot.generate.actor import RecordedPolicy, actor_name, make_actor, open_policy, runtime
from dynahoi_lerobot.verify.command import verify
from tests.dataset.episodes import changed, rewrite
from tests.tools import edit_json

SEEDS = 4


def words(actor: Path | None, root: Path, *more: object) -> list[str]:
    """Return the command for four episodes in two shards, of two kinds whose path is prescribed or thrown."""
    what = ["generate", "--root", root, "--episodes", SEEDS, "--shard-episodes", 2, "--motions", "constant,lob"]
    what += ["--control-class", "late"]
    what += [] if actor is None else ["--actor", actor]
    return [str(word) for word in (*what, *more)]


@pytest.fixture(scope="module")
def generated(actor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("generated") / "d"
    assert main(words(actor, root)) == 0
    return root


@pytest.fixture(scope="module")
def episodes(generated: Path) -> list[Episode]:
    return list(read_episodes(generated))


def test_the_policys_commands_move_the_hand_and_the_labels_do_not(episodes: list[Episode], actor: Path):
    assert {episode.meta.agent for episode in episodes} == {actor_name(str(actor))}
    assert not all(episode.success for episode in episodes), "failures are kept"
    for episode in episodes:
        acting = slice(episode.meta.window_frames, None)
        arrived = episode.state[1:][acting] - episode.executed_action[:-1][acting]
        labelled = episode.state[1:][acting] - episode.action[:-1][acting]
        assert np.abs(arrived[:, :3]).max() < 2e-3
        assert np.abs(labelled[:, :3]).max() > 1e-2


def test_it_is_verified_and_made_again_without_the_policy(generated: Path):
    assert verify(generated, replayed=SEEDS) == []


@pytest.mark.parametrize("name", ["action", "given_action", "executed_action"])
def test_a_replay_finds_labels_and_commands_that_were_not(generated: Path, tmp_path: Path, name: str):
    root = shutil.copytree(generated, tmp_path / "d")
    first, second, *others = read_episodes(root)  # the second is thrown, so nothing prescribes its path
    rewrite(root, [first, changed(name, 20, lambda value: value + 0.02)(second), *others])
    assert f"another {name}" in "\n".join(str(finding) for finding in verify(root, replayed=SEEDS))


@pytest.mark.slow  # two processes import torch
def test_any_number_of_workers_gives_the_same_bytes(generated: Path, actor: Path, tmp_path: Path):
    assert main(words(actor, tmp_path / "d", "--workers", 2)) == 0
    assert Manifest.read(tmp_path / "d").files == Manifest.read(generated).files


def test_another_checkpoint_is_another_dataset(generated, actor, tmp_path, capsys):
    other = shutil.copytree(actor, tmp_path / "other")
    edit_json(other / "config.json", lambda content: content.update(n_action_steps=1))
    assert actor_name(str(other)) != actor_name(str(actor))
    assert main(words(other, generated)) == 2
    assert "holds another dataset (other actor)" in capsys.readouterr().err


@pytest.mark.parametrize("other", ["name", "on"])
def test_a_worker_with_another_checkpoint_or_other_libraries_refuses(actor: Path, other: str):
    policy = open_policy(str(actor))
    known = {"name": actor_name(str(actor)), "on": runtime(policy)}
    assert make_actor(0, path=str(actor), **known).sees_images
    with pytest.raises(PolicyError, match="here; the recording is of something else"):
        make_actor(0, path=str(actor), **known | {other: "something else"})


def test_its_random_numbers_and_threads_are_its_own(actor: Path):
    policy = PolicyAgent(str(actor), "cpu")
    drawn: list[float] = []
    policy.act = lambda observation: drawn.append(torch.rand(()).item())  # type: ignore[method-assign,assignment]
    for seed in (3, 3, 4):
        recorded = RecordedPolicy(policy, seed)
        for _ in range(2):
            torch.manual_seed(len(drawn))
            recorded.act(None)  # type: ignore[arg-type]
            assert torch.initial_seed() == len(drawn) - 1
    assert drawn[:2] == drawn[2:4]
    assert drawn[:2] != drawn[4:]
    assert len(set(drawn[:2])) == 2


def test_rounds_merge_and_the_card_tells_what_they_are(generated: Path, actor: Path, tmp_path: Path):
    assert main(words(None, tmp_path / "first", "--image-size", 32, "--seed", 100)) == 0
    merge([tmp_path / "first", generated], tmp_path / "both")
    assert verify(tmp_path / "both") == []
    both = LeRobotDataset("local/both", root=tmp_path / "both")
    assert len(frame_column(both.root, "executed_action")) == len(both)
    card = (generated / "README.md").read_text()
    assert f"the policy `{actor_name(str(actor))}` moves the hand" in card
    assert "moves the hand, and" not in (tmp_path / "first" / "README.md").read_text()


def test_a_checkpoint_that_could_run_code_is_refused(actor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    hostile = shutil.copytree(actor, tmp_path / "other")
    edit_json(hostile / "config.json", lambda content: content.update(auto_map={"x": "y"}))
    assert main(words(hostile, tmp_path / "d")) == 2
    error = capsys.readouterr().err
    assert "has an auto_map" in error
    assert "give --trust only if" in error


def test_a_recipe_that_names_another_actor_is_refused(actor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("actor: obact@0123456789abcdef\n")
    for given, told in ((None, "give its checkpoint with --actor"), (actor, f"is {actor_name(str(actor))}")):
        assert main(words(given, tmp_path / "d", "--recipe", recipe)) == 2
        assert told in capsys.readouterr().err
    recipe.write_text(f"actor: {actor_name(str(actor))}\nexpert: hold\n")
    assert main(words(actor, tmp_path / "d", "--recipe", recipe)) == 2
    assert "need an expert that labels any state (intercept, match, pursuit), got 'hold'" in capsys.readouterr().err
    recipe.write_text("actor: me\n")
    assert main(words(None, tmp_path / "d", "--recipe", recipe)) == 2
    assert "TYPE@HASH, got 'me'" in capsys.readouterr().err
