from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.dataset import read_episodes
from tests.dataset.episodes import varied_episode, write
from tests.dataset.lerobot_api import REPO, open_dataset

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


def test_windows_over_time(dataset):
    window = {"observation.images.ego": [-0.5, -0.25, 0.0], "action": [0.0, 0.05, 0.1]}
    opened = open_dataset(dataset, delta_timestamps=window)
    item = opened[LENGTHS[0] + 12]
    expected = varied_episode(1)
    np.testing.assert_array_equal(item["action"], expected.action[12:15])
    assert np.abs(hwc(item["observation.images.ego"]) - expected.images["ego"][[2, 7, 12]]).mean() < 6
    last = opened[LENGTHS[0] - 1]
    assert last["action_is_pad"].tolist() == [False, True, True]


def test_episode_columns_can_be_filtered_and_read(dataset):
    opened = open_dataset(dataset, episode_filter=lambda ep: ep["seed"] >= 4 and ep["motion"] == "constant")
    assert opened.episodes == [4, 5]
    assert opened.num_frames == LENGTHS[4] + LENGTHS[5]
    assert opened.meta.episodes[4]["object"] == "ball"
    check_images(opened, 0, 4, 0)


def edit(root: Path, output: Path, **operation):
    from lerobot.datasets import dataset_tools

    name, arguments = operation.popitem()
    return getattr(dataset_tools, name)(open_dataset(root), output_dir=output, **arguments)


def test_split(dataset, tmp_path):
    parts = edit(dataset, tmp_path, split_dataset={"splits": {"a": [0, 2, 4], "b": [1, 3, 5]}})
    assert {name: part.num_episodes for name, part in parts.items()} == {"a": 3, "b": 3}
    check_images(parts["b"], LENGTHS[1] + LENGTHS[3] + 7, 5, 7)


def test_delete_episodes(dataset, tmp_path):
    rest = edit(dataset, tmp_path / "rest", delete_episodes={"episode_indices": [0, 3], "repo_id": REPO})
    assert rest.num_episodes == 4
    assert rest.meta.features["observation.images.ego"]["info"]["video.codec"] == "h264"
    check_images(rest, LENGTHS[1] + LENGTHS[2] + 5, 4, 5)


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


def test_viz_loads_an_episode(dataset):
    import torch

    opened = open_dataset(dataset, episodes=[3])
    loader = torch.utils.data.DataLoader(opened, num_workers=0, batch_size=8)
    frames = [int(frame) for batch in loader for frame in batch["frame_index"]]
    assert frames == list(range(LENGTHS[3]))
