"""Episodes on disk as LeRobotDataset v3.0: writing, reading, merging and subsets, without a simulator."""

from dynahoi_lerobot.dataset.episodes import open_dataset, read_episodes, write_episodes
from dynahoi_lerobot.dataset.store import frame_column

__all__ = ["frame_column", "open_dataset", "read_episodes", "write_episodes"]
