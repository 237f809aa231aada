"""Our datasets in the hands of LeRobot: the same as its own, opened, streamed, merged, and learned
from.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import torch
from datasets import load_dataset
from lerobot.datasets.compute_stats import aggregate_stats
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, split_dataset
from lerobot.datasets.language_render import active_at
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.video_utils import RGBEncoderConfig
from lerobot.rl.buffer import ReplayBuffer
from lerobot.scripts.lerobot_eval import _env_features_to_dataset_features
from lerobot.utils.collate import lerobot_collate_fn

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.dataset import open_dataset, read_episodes, write_episodes
from dynahoi_lerobot.dataset.columns import (
    BOOKKEEPING,
    LANGUAGE,
    SUBTASKS,
    content_arrays,
    dataset_features,
    info_features,
    subtask_rows,
)
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.verify.command import verify
from tests.dataset.episodes import varied_episode, write
from tests.synthetic import synthetic_episode
from tests.tools import generated

SEEDS = range(4)
REPO = "local/dataset"
IMAGES = "observation.images.ego"
MOMENTS = ("min", "max", "mean", "std", "count")


def write_with_lerobot(root: Path, episodes: list[Episode], encoding) -> None:
    """The same episodes through LeRobot's own recording interface."""
    columns = dataset_features(episodes[0])
    described = info_features(columns, encoding)
    features = {key: feature for key, feature in described.items() if key not in BOOKKEEPING}
    for feature in features.values():
        feature.pop("info", None)
        feature["shape"] = tuple(feature["shape"])
    encoder = RGBEncoderConfig(
        vcodec="h264", crf=encoding.crf, preset=encoding.preset, g=encoding.gop, fast_decode=1
    )
    dataset = LeRobotDataset.create(
        REPO,
        20,
        features,
        root=root,
        robot_type="dynahoi_hand",
        rgb_encoder=encoder,
        encoder_threads=1,
    )
    for episode in episodes:
        arrays = content_arrays(episode, columns)
        for frame in range(len(episode)):
            row = {key: np.asarray(values[frame]) for key, values in arrays.items()}
            dataset.add_frame(
                row | {IMAGES: episode.images["ego"][frame], "task": episode.meta.task}
            )
        dataset.save_episode()
    dataset.finalize()


@pytest.fixture(scope="module", params=["h264", "images"])
def pair(request, tmp_path_factory) -> tuple[Path, Path]:
    """The same episodes written by us and by LeRobot."""
    folder = tmp_path_factory.mktemp("pair")
    encoding = Encoding(codec=request.param)
    episodes = [varied_episode(seed) for seed in SEEDS]
    write_episodes(folder / "ours", episodes, encoding)
    write_with_lerobot(folder / "theirs", episodes, encoding)
    return folder / "ours", folder / "theirs"


def load(root: Path, name: str):
    return json.loads((root / name).read_text())


def test_info_and_tasks_are_the_same(pair):
    ours, theirs = (load(root, "meta/info.json") for root in pair)
    if theirs["features"][IMAGES]["dtype"] == "image":
        theirs["video_path"] = None
    assert ours == theirs
    for one, other in ((ours, theirs), (ours["features"], theirs["features"])):
        assert list(one) == list(other), "in the same order"
    pd.testing.assert_frame_equal(*(open_dataset(root).meta.tasks for root in pair))


def test_frames_are_the_same(pair):
    ours, theirs = (pq.read_table(root / "data/chunk-000/file-000.parquet") for root in pair)
    assert ours.equals(theirs)
    features = [
        json.loads(table.schema.metadata[b"huggingface"])["info"] for table in (ours, theirs)
    ]
    assert features[0] == features[1]


def test_episode_rows_are_the_same_where_lerobot_has_them(pair):
    """Their statistics are of the same types here; `test_written` computes them."""
    ours, theirs = (
        pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet") for root in pair
    )
    for field in theirs.schema:
        assert ours.schema.field(field.name).type == field.type
        if not field.name.startswith("stats/"):
            places = theirs[field.name].to_pylist()
            wanted = pytest.approx(places) if "timestamp" in field.name else places
            assert ours[field.name].to_pylist() == wanted, field.name


def test_dataset_statistics_are_the_same_but_for_pinned_quantiles_of_columns(pair):
    ours, theirs = (load(root, "meta/stats.json") for root in pair)
    assert set(ours) == set(theirs)
    for key, stats in theirs.items():
        for name, value in stats.items():
            assert np.shape(ours[key][name]) == np.shape(value)
            if name in MOMENTS or key == IMAGES:
                atol = 3e-4 if name in MOMENTS else 1 / 4900
                np.testing.assert_allclose(
                    ours[key][name], value, atol=atol, err_msg=f"{key} {name}"
                )


LENGTHS = [20 + seed % 7 for seed in range(6)]


def check_images(dataset, index: int, seed: int, frame: int) -> None:
    image = np.moveaxis(dataset[index][IMAGES].numpy() * 255, -3, -1)
    assert np.abs(image - varied_episode(seed).images["ego"][frame]).mean() < 6


def test_opens_and_its_episode_columns_can_be_filtered_and_read(dataset):
    opened = open_dataset(dataset)
    assert (opened.num_episodes, opened.num_frames, opened.fps) == (6, sum(LENGTHS), 20)
    first_of_third = LENGTHS[0] + LENGTHS[1]
    check_images(opened, first_of_third + 3, 2, 3)
    item = opened[first_of_third + 3]
    np.testing.assert_array_equal(item["action"], varied_episode(2).action[3])
    assert item["task"] == "Catch the red ball."
    chosen = open_dataset(
        dataset, episode_filter=lambda ep: ep["seed"] >= 4 and ep["motion"] == "constant"
    )
    assert (chosen.episodes, chosen.num_frames) == ([4, 5], LENGTHS[4] + LENGTHS[5])
    assert chosen.meta.episodes[4]["object"] == "ball"
    check_images(chosen, 0, 4, 0)


def test_merge(dataset, tmp_path):
    other = write(tmp_path / "other", range(6, 9))
    merged = merge_datasets([open_dataset(dataset), open_dataset(other)], REPO, tmp_path / "merged")
    assert merged.num_episodes == 9
    assert merged.meta.episodes["seed"] == list(range(9))
    check_images(merged, sum(LENGTHS) + 4, 6, 4)
    with pytest.raises(ReadError, match="no privileged tables"):
        next(read_episodes(tmp_path / "merged"))


def test_a_reader_that_takes_names_of_statistics_apart_gets_those_of_the_dataset(dataset):
    found: list[dict[str, dict[str, np.ndarray]]] = [{} for _ in LENGTHS]
    for name, cells in pq.read_table(dataset / "meta/episodes").to_pydict().items():
        if name.startswith("stats/"):
            _, feature, statistic = name.split("/", 2)
            for stats, cell in zip(found, cells, strict=True):
                stats.setdefault(feature, {})[statistic] = np.array(cell)
    for feature, told in load(dataset, "meta/stats.json").items():
        pooled = aggregate_stats(found)[feature]
        for name in MOMENTS:
            np.testing.assert_allclose(pooled[name], told[name], atol=1e-6, err_msg=feature)


def test_datasets_loads_the_frames_and_nothing_else_by_the_card(dataset, tmp_path):
    loaded = load_dataset(str(dataset), split="train", cache_dir=str(tmp_path))
    assert loaded.num_rows == sum(LENGTHS)
    described = load(dataset, "meta/info.json")["features"]
    assert {*loaded.column_names} == {k for k, e in described.items() if e["dtype"] != "video"}


MEASURED = ("ego_depth", "side_segmentation")


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("measured") / "d", range(3), views=("side", *MEASURED))


def test_measurements_are_not_encoded_as_video(measured: Path):
    opened = open_dataset(measured)
    keys = [f"observation.images.{view}" for view in MEASURED]
    assert opened.meta.image_keys == keys
    assert opened.meta.video_keys == ["observation.images.ego", "observation.images.side"]
    for seed, episode in enumerate(read_episodes(measured)):
        shown = varied_episode(seed, views=("side", *MEASURED)).images
        for view in MEASURED:
            np.testing.assert_array_equal(episode.images[view], shown[view])
    image = np.moveaxis(opened[4][keys[0]].numpy() * 255, 0, -1).round()
    shown = varied_episode(0, views=("side", *MEASURED)).images[MEASURED[0]]
    np.testing.assert_array_equal(image, shown[4])
    assert verify(measured) == []


def test_lerobot_edits_videos_and_images_side_by_side(measured: Path, tmp_path: Path):
    source = open_dataset(measured)
    delete_episodes(source, [0], tmp_path / "fewer", REPO)
    split_dataset(source, {"one": [0], "two": [1, 2]}, tmp_path)
    merge_datasets([source, source], REPO, tmp_path / "merged")
    edits = {"fewer": [1, 2], "one": [0], "two": [1, 2], "merged": [0, 1, 2] * 2}
    for name, seeds in edits.items():
        edited = open_dataset(tmp_path / name)
        assert edited.num_frames == sum(LENGTHS[seed] for seed in seeds)
        wanted = varied_episode(seeds[-1], views=("side", *MEASURED)).images["ego_depth"][-1]
        image = edited[len(edited) - 1]["observation.images.ego_depth"].numpy() * 255
        np.testing.assert_array_equal(np.moveaxis(image, 0, -1).round(), wanted)
        check_images(edited, len(edited) - 1, seeds[-1], -1)


STATE = "observation.state"


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> tuple[Path, list[Episode]]:
    """A caught and a missed target."""
    episodes = [
        synthetic_episode(0, image_size=None),
        synthetic_episode(1, image_size=None, miss_m=0.2),
    ]
    assert [episode.success for episode in episodes] == [True, False]
    root = tmp_path_factory.mktemp("stored") / "d"
    write_episodes(root, episodes)
    return root, episodes


def test_the_replay_buffer_gets_a_reward_per_success_and_an_end_per_episode(stored) -> None:
    root, episodes = stored
    transitions = ReplayBuffer._lerobotdataset_to_transitions(open_dataset(root), [STATE])
    ends = np.cumsum([len(episode) for episode in episodes]) - 1
    assert np.flatnonzero([t["done"] for t in transitions]).tolist() == ends.tolist()
    rewards = np.array([t["reward"] for t in transitions])
    rewarded = int(rewards.argmax())
    first = episodes[0].first_localized
    after = torch.tensor(episodes[0].state[first])
    assert rewarded == first - 1, "the action that leads to success"
    assert torch.equal(transitions[rewarded]["next_state"][STATE][0], after)
    assert not transitions[rewarded]["done"]
    assert rewards[episodes[0].meta.window_frames : first - 1].min() > 0, "the hand comes closer"


def test_the_columns_are_those_of_lerobots_own_recordings(stored) -> None:
    features = open_dataset(stored[0]).meta.features
    for key, theirs in _env_features_to_dataset_features({}).items():
        assert (features[key]["dtype"], tuple(features[key]["shape"])) == (
            theirs["dtype"],
            theirs["shape"],
        ), key


WATCH, REACH, HOLD = SUBTASKS


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    words = ["--image-size", "0", "--motions", "constant,lob", "--subtasks"]
    return generated(tmp_path_factory.mktemp("data") / "d", *words)


def test_a_target_that_is_never_localised_is_never_to_be_held() -> None:
    rows = subtask_rows(np.array([False, False, True, True]), np.zeros(4, bool))
    assert [(row["content"], row["timestamp"]) for row in rows] == [
        (WATCH, 0.0),
        (REACH, pytest.approx(0.1)),
    ]
    assert [
        row["content"] for row in subtask_rows(np.ones(3, bool), np.array([False, True, True]))
    ] == [REACH, HOLD]


def test_lerobot_finds_the_subtask_of_every_frame(root: Path) -> None:
    dataset = open_dataset(root, delta_timestamps={"action": [0.0, 0.05]})
    assert dataset.meta.has_language_columns
    (first, _) = read_episodes(root)
    samples = [dataset[i] for i in range(len(first))]
    found = [
        active_at(float(s["timestamp"]), persistent=s[LANGUAGE], style="subtask")["content"]
        for s in samples
    ]
    wanted = [
        HOLD if held else REACH if acts else WATCH
        for (_, acts), held in zip(first.phase, first.localized, strict=True)
    ]
    assert found == wanted
    assert set(found) == {WATCH, REACH, HOLD}
    assert lerobot_collate_fn(samples[:2])["action"].shape == (2, 2, 18)
