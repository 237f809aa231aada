"""Episodes on disk as LeRobotDataset v3.0: writing, reading, merging and subsets, without a
simulator.
"""

from dynahoi_lerobot.dataset.store import episode_column, frame_column, open_dataset, read_episodes
from dynahoi_lerobot.dataset.writer import write_episodes

__all__ = ["episode_column", "frame_column", "open_dataset", "read_episodes", "write_episodes"]
