from __future__ import annotations

import dataclasses
import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import CAMERA_KEY
from dynahoi_lerobot.core.registry import UnknownNameError
from dynahoi_lerobot.dataset import read_episodes, write_episodes
from dynahoi_lerobot.dataset.codecs import CODECS, Encoding
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import count_frames
from tests.dataset.episodes import varied_episode, write


@pytest.mark.parametrize("codec", CODECS.names())
def test_same_episodes_give_same_bytes(codec, tmp_path):
    first, second = (write(tmp_path / name, range(3), 64, encoding=Encoding(codec)) for name in "ab")
    assert hash_files(first) == hash_files(second)
    assert Manifest.read(first) == Manifest.read(second)
    assert hash_files(first) == Manifest.read(first).files


@pytest.mark.parametrize("codec", CODECS.names())
def test_episodes_come_back_as_they_were(codec, tmp_path):
    episodes = [varied_episode(seed, 64, ("side",)) for seed in range(3)]
    write_episodes(tmp_path / "d", episodes, Encoding(codec))
    for before, after in zip(episodes, read_episodes(tmp_path / "d"), strict=True):
        assert after.meta == before.meta
        assert (after.success, after.stage) == (before.success, before.stage)
        assert after.intercept_time == pytest.approx(before.intercept_time, abs=1e-6)
        for field in dataclasses.fields(before):
            value = getattr(before, field.name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(getattr(after, field.name), np.asarray(value), field.name)
        assert list(after.images) == list(before.images) == ["ego", "side"]
        for view, images in before.images.items():
            error = np.abs(after.images[view].astype(int) - images.astype(int)).mean()
            assert error == 0 if codec == "images" else error < 6


def test_without_a_camera(tmp_path):
    episodes = [varied_episode(seed, None) for seed in range(2)]
    write_episodes(tmp_path / "d", episodes)
    assert not (tmp_path / "d/videos").exists()
    assert [episode.images for episode in read_episodes(tmp_path / "d")] == [{}, {}]


def with_touch(seed: int) -> Episode:
    episode = varied_episode(seed, None)
    force = np.random.default_rng(seed).uniform(0, 9, (len(episode), 5)).astype(np.float32)
    return dataclasses.replace(episode, touch=force)


def test_touch_comes_back_and_is_absent_where_it_was(tmp_path):
    felt = [with_touch(seed) for seed in range(2)]
    write_episodes(tmp_path / "felt", felt)
    for before, after in zip(felt, read_episodes(tmp_path / "felt"), strict=True):
        np.testing.assert_array_equal(after.touch, before.touch)
    write_episodes(tmp_path / "plain", [varied_episode(0, None)])
    assert next(read_episodes(tmp_path / "plain")).touch is None
    assert "observation.touch" not in Store(tmp_path / "plain").features


@pytest.mark.parametrize(
    ("first", "second", "sentence"),
    [
        (
            with_touch(0),
            varied_episode(1, None),
            r"seed 1 has no observation\.touch, .* observation\.touch of shape \(21, 5\)",
        ),
        (
            varied_episode(0, None),
            with_touch(1),
            r"observation\.touch of shape \(21, 5\), the dataset needs no observation",
        ),
        (varied_episode(0), varied_episode(1, None), r"has no observation\.images\.ego, .* of shape \(21, 32, 32, 3\)"),
        (varied_episode(0), varied_episode(1, 32, ("side",)), r"the dataset needs no observation\.images\.side"),
        (
            varied_episode(0),
            varied_episode(1, 16),
            r"ego of shape \(21, 16, 16, 3\), .*ego of shape \(21, 32, 32, 3\)",
        ),
        (
            varied_episode(0),
            dataclasses.replace(varied_episode(1), palm_distance=np.zeros(3, np.float32)),
            r"stats/palm_distance of shape \(3,\), the dataset needs stats/palm_distance of shape \(21,\)",
        ),
    ],
)
def test_an_episode_with_other_columns_is_refused_by_name(tmp_path, first, second, sentence):
    with pytest.raises(ValueError, match=sentence):
        write_episodes(tmp_path / "d", [first, second])
    assert not any(tmp_path.iterdir())


def test_files_roll_over_at_their_limits(tmp_path):
    layout = FileLimits(data_mb=0.01, video_mb=0.003, chunk_files=2)
    store = Store(write(tmp_path / "d", range(8), limits=layout))
    assert len(store.data_files()) > 2
    assert {row["data/chunk_index"] for row in store.rows} > {0}
    videos = [store.video_path(row, CAMERA_KEY) for row in store.rows]
    assert len(set(videos)) > 2
    for row, path in zip(store.rows, videos, strict=True):
        assert len(store.frames(row)) == row["length"]
        assert count_frames(path) == sum(r["length"] for r, p in zip(store.rows, videos, strict=True) if p == path)
        images = store.images(row, store.frames(row), CAMERA_KEY)
        assert np.abs(images.astype(int) - varied_episode(row["seed"]).images["ego"]).mean() < 6


def test_videos_stay_short_enough_to_open_quickly(tmp_path):
    store = Store(write(tmp_path / "d", range(4), 16, limits=FileLimits(video_s=2.3)))
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
    with pytest.raises(ValueError, match="33 pixels; video needs an even number"):
        write_episodes(tmp_path / "d", [varied_episode(1, 33)])
    with pytest.raises(ValueError, match="at least one"):
        write_episodes(tmp_path / "d", [])
    assert not any(tmp_path.iterdir())


def test_existing_folder_is_left_alone(dataset):
    before = hash_files(dataset)
    with pytest.raises(FileExistsError, match="choose a new folder"):
        write_episodes(dataset, [varied_episode(0)])
    assert hash_files(dataset) == before
