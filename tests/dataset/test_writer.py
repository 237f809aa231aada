from __future__ import annotations

import dataclasses
import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.dataset import read_episodes, write_episodes
from dynahoi_lerobot.dataset.codecs.base import CODECS, Encoding
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import count_frames
from dynahoi_lerobot.features import CAMERA_KEY
from dynahoi_lerobot.foundation.registry import UnknownNameError
from tests.dataset.episodes import varied_episode, write


@pytest.mark.parametrize("codec", CODECS.names())
def test_same_episodes_give_same_bytes(codec, tmp_path):
    first, second = (write(tmp_path / name, range(3), 64, encoding=Encoding(codec)) for name in "ab")
    assert hash_files(first) == hash_files(second)
    assert Manifest.read(first) == Manifest.read(second)
    assert hash_files(first) == Manifest.read(first).files


@pytest.mark.parametrize("codec", CODECS.names())
def test_episodes_come_back_as_they_were(codec, tmp_path):
    episodes = [varied_episode(seed, 64) for seed in range(3)]
    write_episodes(tmp_path / "d", episodes, 64, Encoding(codec))
    for before, after in zip(episodes, read_episodes(tmp_path / "d"), strict=True):
        assert after.meta == before.meta
        assert (after.success, after.stage) == (before.success, before.stage)
        assert after.intercept_time == pytest.approx(before.intercept_time, abs=1e-6)
        for field in dataclasses.fields(before):
            value = getattr(before, field.name)
            if isinstance(value, np.ndarray) and field.name != "images":
                np.testing.assert_array_equal(getattr(after, field.name), np.asarray(value), field.name)
        error = np.abs(after.images.astype(int) - before.images.astype(int)).mean()
        assert error == 0 if codec == "images" else error < 6


def test_without_a_camera(tmp_path):
    episodes = [varied_episode(seed, None) for seed in range(2)]
    write_episodes(tmp_path / "d", episodes, None)
    assert not (tmp_path / "d/videos").exists()
    assert all(episode.images is None for episode in read_episodes(tmp_path / "d"))


def test_files_roll_over_at_their_limits(tmp_path):
    layout = FileLimits(data_mb=0.01, video_mb=0.003, chunk_files=2)
    store = Store(write(tmp_path / "d", range(8), layout=layout))
    assert len(store.data_files()) > 2
    assert {row["data/chunk_index"] for row in store.rows} > {0}
    videos = [store.video_path(row, CAMERA_KEY) for row in store.rows]
    assert len(set(videos)) > 2
    for row, path in zip(store.rows, videos, strict=True):
        assert len(store.frames(row)) == row["length"]
        assert count_frames(path) == sum(r["length"] for r, p in zip(store.rows, videos, strict=True) if p == path)
        images = store.images(row, store.frames(row), CAMERA_KEY)
        assert np.abs(images.astype(int) - varied_episode(row["seed"]).images).mean() < 6


def test_videos_stay_short_enough_to_open_quickly(tmp_path):
    store = Store(write(tmp_path / "d", range(4), 16, layout=FileLimits(video_s=2.3)))
    ends = [row["videos/observation.images.ego/to_timestamp"] for row in store.rows]
    assert max(ends) <= 2.3
    assert len({store.video_path(row, CAMERA_KEY) for row in store.rows}) == 2


def test_each_episode_starts_with_a_key_frame(dataset):
    import av

    store = Store(dataset)
    starts = {round(row["videos/observation.images.ego/from_timestamp"] * 20) for row in store.rows}
    with av.open(str(store.video_path(store.rows[0], CAMERA_KEY))) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    assert starts <= {number for number, packet in enumerate(packets) if packet.is_keyframe}
    assert [packet.pts for packet in packets] == sorted(packet.pts for packet in packets)


def test_one_row_group_per_episode(dataset):
    store = Store(dataset)
    assert pq.read_metadata(store.data_files()[0]).num_row_groups == store.episodes


def test_per_episode_columns(dataset):
    for seed, row in enumerate(Store(dataset).rows):
        episode = varied_episode(seed)
        assert dataclasses.asdict(episode.meta).items() <= row.items()
        assert json.loads(row["parameters"]) == episode.meta.motion_parameters


def test_unknown_codec_names_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"unknown codec 'h246' \(did you mean 'h264'\?\)"):
        Encoding(codec="h246")


@pytest.mark.parametrize("options", [{"gop": 0}, {"crf": -1}])
def test_impossible_encoding_is_refused(options):
    with pytest.raises(ValueError, match="it must be"):
        Encoding(**options)


def test_wrong_images_are_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r"seed 1 has observation.images.ego of shape \(21, 16, 16, 3\).*needs \(21, 32, 32, 3\)"
    ):
        write_episodes(tmp_path / "d", [varied_episode(1, 16)], 32)
    with pytest.raises(ValueError, match="33 pixels; video needs an even number"):
        write_episodes(tmp_path / "d", [varied_episode(1, 33)], 33)
    with pytest.raises(ValueError, match="no episode"):
        write_episodes(tmp_path / "d", [], 32)
    assert not any(tmp_path.iterdir())


def test_existing_folder_is_left_alone(dataset):
    before = hash_files(dataset)
    with pytest.raises(FileExistsError, match="choose a new folder"):
        write_episodes(dataset, [varied_episode(0)], 32)
    assert hash_files(dataset) == before
