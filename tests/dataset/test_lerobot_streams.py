"""``StreamingLeRobotDataset`` reads our datasets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.features import frame_features
from dynahoi_lerobot.dataset.video import Encoding
from tests.dataset.episodes import varied_episode, write
from tests.dataset.lerobot_api import REPO


def stream(root: Path, window: dict[str, list[float]] | None = None, **options):
    from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

    options = {"shuffle": False, "buffer_size": 1} | options
    return iter(StreamingLeRobotDataset(REPO, root=root, delta_timestamps=window, **options))


def test_streams(tmp_path, monkeypatch):
    from lerobot.datasets import streaming_dataset
    from lerobot.datasets.video_utils import decode_video_frames_pyav

    def decode(path, timestamps, tolerance_s, **_):
        return decode_video_frames_pyav(path, timestamps, tolerance_s)

    # Its only decoder, torchcodec, needs libraries of the system.
    monkeypatch.setattr(streaming_dataset, "decode_video_frames_torchcodec", decode)
    items = stream(write(tmp_path / "d", range(2)), {"action": [0.0, 0.05], "observation.images.ego": [-0.05, 0.0]})
    item = next(item for item in items if int(item["episode_index"]) == 1 and int(item["frame_index"]) == 3)
    expected = varied_episode(1)
    np.testing.assert_array_equal(item["action"], expected.action[3:5])
    shown = np.moveaxis(item["observation.images.ego"].numpy() * 255, -3, -1)
    assert np.abs(shown - expected.images["ego"][2:4]).mean() < 6


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
