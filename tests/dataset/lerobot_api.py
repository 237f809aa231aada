"""What the tests need from LeRobot, imported late and quietly."""

import logging
from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset.columns import BOOKKEEPING, content_arrays, dataset_features, info_features

logging.disable(logging.WARNING)

from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402
from lerobot.datasets.video_utils import RGBEncoderConfig  # noqa: E402

logging.disable(logging.NOTSET)

REPO = "local/dataset"


def write_with_lerobot(root: Path, episodes: list[Episode], encoding) -> LeRobotDataset:
    """The same episodes through LeRobot's own recording interface."""
    columns = dataset_features(episodes[0])
    described = info_features(columns, encoding)
    features = {key: feature for key, feature in described.items() if key not in BOOKKEEPING}
    for feature in features.values():
        feature.pop("info", None)
        feature["shape"] = tuple(feature["shape"])
    encoder = RGBEncoderConfig(vcodec="h264", crf=encoding.crf, preset=encoding.preset, g=encoding.gop, fast_decode=1)
    dataset = LeRobotDataset.create(
        REPO, 20, features, root=root, robot_type="dynahoi_hand", rgb_encoder=encoder, encoder_threads=1
    )
    for episode in episodes:
        arrays = content_arrays(episode, columns)
        for frame in range(len(episode)):
            row = {key: np.asarray(values[frame]) for key, values in arrays.items()}
            dataset.add_frame(row | {"observation.images.ego": episode.images["ego"][frame], "task": episode.meta.task})
        dataset.save_episode()
    dataset.finalize()
    return dataset
