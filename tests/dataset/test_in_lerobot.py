"""Our datasets in the hands of LeRobot and ``datasets``: opened, streamed, edited, merged, and learned from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.rl.buffer import ReplayBuffer

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import frame_features
from dynahoi_lerobot.dataset import read_episodes, write_episodes
from dynahoi_lerobot.dataset.columns import LANGUAGE, SUBTASKS, subtask_rows
from dynahoi_lerobot.dataset.video import Encoding
from tests.dataset.episodes import varied_episode, write
from tests.dataset.lerobot_api import REPO, open_dataset
from tests.synthetic import synthetic_episode

LENGTHS = [20 + seed % 7 for seed in range(6)]


def hwc(tensor) -> np.ndarray:
    return np.moveaxis(tensor.numpy() * 255, -3, -1)


def check_images(dataset, index: int, seed: int, frame: int) -> None:
    image = hwc(dataset[index]["observation.images.ego"])
    assert np.abs(image - varied_episode(seed).images["ego"][frame]).mean() < 6


def test_opens(dataset):
    opened = open_dataset(dataset)
    assert (opened.num_episodes, opened.num_frames, opened.fps) == (6, sum(LENGTHS), 20)
    first_of_third = LENGTHS[0] + LENGTHS[1]
    check_images(opened, first_of_third + 3, 2, 3)
    item = opened[first_of_third + 3]
    np.testing.assert_array_equal(item["action"], varied_episode(2).action[3])
    assert item["task"] == "Catch the red ball."
    assert not [name for name in opened.meta.episodes.column_names if name.startswith("stats/")]


def test_episode_columns_can_be_filtered_and_read(dataset):
    opened = open_dataset(dataset, episode_filter=lambda ep: ep["seed"] >= 4 and ep["motion"] == "constant")
    assert opened.episodes == [4, 5]
    assert opened.num_frames == LENGTHS[4] + LENGTHS[5]
    assert opened.meta.episodes[4]["object"] == "ball"
    check_images(opened, 0, 4, 0)


@pytest.mark.parametrize("concatenate", [True, False])
def test_merge(dataset, tmp_path, concatenate):
    from lerobot.datasets.dataset_tools import merge_datasets

    other = write(tmp_path / "other", range(6, 9))
    merged = merge_datasets(
        [open_dataset(dataset), open_dataset(other)], REPO, tmp_path / "merged", concatenate, concatenate
    )
    assert merged.num_episodes == 9
    assert merged.meta.episodes["seed"] == list(range(9))
    check_images(merged, sum(LENGTHS) + 4, 6, 4)
    episode = list(read_episodes(tmp_path / "merged"))[7]
    for name in ("palm_distance", "state", "target_pose", "localized", "intercept_position"):
        np.testing.assert_allclose(getattr(episode, name), getattr(varied_episode(7), name), err_msg=name)
    assert episode.meta == varied_episode(7).meta


def stream(root: Path, window: dict[str, list[float]] | None = None, **options):
    from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

    options = {"shuffle": False, "buffer_size": 1} | options
    return iter(StreamingLeRobotDataset(REPO, root=root, delta_timestamps=window, **options))


def test_streams_windows_over_every_observation(tmp_path):
    """A policy with history asks for a window over each of them; images are in the frame table."""
    images = write(tmp_path / "d", range(2), encoding=Encoding("images"))
    observed = [feature for feature in frame_features(None) if feature.observed]
    window = {feature.key: [-0.05, 0.0] for feature in observed}
    items = stream(images, window | {"observation.images.ego": [-0.05, 0.0]})
    expected = varied_episode(0)
    item = next(item for item in items if int(item["frame_index"]) == expected.meta.window_frames)
    for feature in observed:
        wanted = getattr(expected, feature.name)[expected.meta.window_frames - 1 :][:2]
        np.testing.assert_array_equal(item[feature.key], wanted, feature.key)
    assert item["observation.images.ego"].shape == (2, 3, 32, 32)


@pytest.mark.parametrize("codec", ["h264", "images"])
def test_columns_have_types_and_shapes(codec: str, tmp_path: Path):
    datasets = pytest.importorskip("datasets")
    write(tmp_path / "d", range(2), encoding=Encoding(codec=codec))
    table = datasets.load_dataset(str(tmp_path / "d"), split="train", cache_dir=str(tmp_path / "cache"))
    episodes = list(read_episodes(tmp_path / "d"))
    assert len(table) == sum(map(len, episodes))
    kinds = table.features
    assert (kinds["action"].feature.dtype, kinds["action"].length) == ("float32", 18)
    assert (kinds["timestamp"].dtype, kinds["episode_index"].dtype) == ("float32", "int64")
    assert kinds["next.success"].dtype == "bool"
    np.testing.assert_array_equal(table[0]["observation.state"], episodes[0].state[0])
    if codec == "images":
        assert isinstance(kinds["observation.images.ego"], datasets.Image)
        np.testing.assert_array_equal(np.asarray(table[0]["observation.images.ego"]), episodes[0].images["ego"][0])


STATE = "observation.state"


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> tuple[Path, list[Episode]]:
    """A caught and a missed target."""
    episodes = [synthetic_episode(0, image_size=None), synthetic_episode(1, image_size=None, miss_m=0.2)]
    assert [episode.success for episode in episodes] == [True, False]
    root = tmp_path_factory.mktemp("stored") / "d"
    write_episodes(root, episodes)
    return root, episodes


def test_the_replay_buffer_gets_a_reward_per_success_and_an_end_per_episode(stored) -> None:
    root, episodes = stored
    transitions = ReplayBuffer._lerobotdataset_to_transitions(open_dataset(root), [STATE])
    ends = np.cumsum([len(episode) for episode in episodes]) - 1
    assert np.flatnonzero([t["done"] for t in transitions]).tolist() == ends.tolist()
    (rewarded,) = np.flatnonzero([t["reward"] for t in transitions])
    first = episodes[0].first_localized
    after = torch.tensor(episodes[0].state[first])
    assert rewarded == first - 1, "the action that leads to success"
    assert torch.equal(transitions[rewarded]["next_state"][STATE][0], after)
    assert not transitions[rewarded]["done"]


def test_the_columns_are_those_of_lerobots_own_recordings(stored) -> None:
    from lerobot.scripts.lerobot_eval import _env_features_to_dataset_features

    features = open_dataset(stored[0]).meta.features
    for key, theirs in _env_features_to_dataset_features({}).items():
        assert (features[key]["dtype"], tuple(features[key]["shape"])) == (theirs["dtype"], theirs["shape"]), key


WATCH, REACH, HOLD = SUBTASKS


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    words = ["--root", str(root), "--episodes", "2", "--image-size", "0", "--motions", "constant,lob", "--subtasks"]
    assert main(["generate", *words]) == 0
    return root


def test_a_target_that_is_never_localised_is_never_to_be_held() -> None:
    rows = subtask_rows(np.array([False, False, True, True]), np.zeros(4, bool))
    assert [(row["content"], row["timestamp"]) for row in rows] == [(WATCH, 0.0), (REACH, pytest.approx(0.1))]
    assert [row["content"] for row in subtask_rows(np.ones(3, bool), np.array([False, True, True]))] == [REACH, HOLD]


def test_lerobot_finds_the_subtask_of_every_frame(root: Path) -> None:
    from lerobot.configs.recipe import MessageTurn, TrainingRecipe
    from lerobot.datasets.language_render import active_at, render_sample
    from lerobot.utils.collate import lerobot_collate_fn

    dataset = open_dataset(root, delta_timestamps={"action": [0.0, 0.05]})
    assert dataset.meta.has_language_columns
    (first, _) = read_episodes(root)
    samples = [dataset[i] for i in range(len(first))]
    found = [active_at(float(s["timestamp"]), persistent=s[LANGUAGE], style="subtask")["content"] for s in samples]
    wanted = [
        HOLD if held else REACH if acts else WATCH for (_, acts), held in zip(first.phase, first.localized, strict=True)
    ]
    assert found == wanted
    assert set(found) == {WATCH, REACH, HOLD}
    assert lerobot_collate_fn(samples[:2])["action"].shape == (2, 2, 18)
    turns = [
        MessageTurn(role="user", content="${task}", stream="high_level"),
        MessageTurn(role="assistant", content="${subtask}", stream="high_level", target=True),
    ]
    sample, recipe = samples[-1], TrainingRecipe(messages=turns)
    rendered = render_sample(
        recipe=recipe, persistent=sample[LANGUAGE], events=[], t=float(sample["timestamp"]), sample_idx=0,
        task=sample["task"],
    )  # fmt: skip
    assert [message["content"] for message in rendered["messages"]] == [first.meta.task, HOLD]
