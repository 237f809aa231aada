"""Where the parts of a LeRobotDataset v3.0 lie on disk, and how large they may grow."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CODEBASE_VERSION = "v3.0"
ROBOT_TYPE = "dynahoi_hand"

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
PRIVILEGED_PATH = "meta/privileged/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
PRIVILEGED_EPISODES_PATH = (
    "meta/privileged_episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
)
"""Ours; LeRobot fetches them with the rest of ``meta/``, does not read them, and drops them when it
edits."""
TASKS_PATH = "meta/tasks.parquet"
INFO_PATH = "meta/info.json"
STATS_PATH = "meta/stats.json"
MANIFEST_PATH = "meta/manifest.json"
"""Ours; LeRobot ignores it."""
CARD_PATH = "README.md"
HISTOGRAM_PATH = "assets/{key}.svg"
"""The dataset card, which the Hub shows, and its drawings."""


UNOPENABLE = ("[", "*", "?", "::")
"""What LeRobot's reader takes for a pattern or a chain of addresses in a path."""


def check_root(root: Path) -> None:
    """Refuse a folder that LeRobot cannot open, or opens together with its neighbors.

    Raises:
        ValueError: naming the part of the path.
    """
    found = [part for part in UNOPENABLE if part in str(root.absolute())]
    if found:
        raise ValueError(
            f"LeRobot cannot open a dataset in {root.absolute()}: it reads {found[0]!r} as part "
            f"of a pattern; choose a "
            f"path without {', '.join(UNOPENABLE)}"
        )


@dataclass(frozen=True)
class FileLimits:
    """Where a dataset's data, video and episode files end and the next one begins.

    Attributes:
        data_mb: largest parquet file [MiB], LeRobot's default.
        video_mb: largest mp4 file [MiB], LeRobot's default.
        video_s: longest mp4 file [s]. LeRobot's PyAV reader opens the file for every sample and
            reads its whole index: two frames cost 11 ms in a file of 16,000 frames and 26 ms in one
            of 64,000.
        chunk_files: files per chunk folder, LeRobot's default.
    """

    data_mb: float = 100
    video_mb: float = 200
    video_s: float = 1000.0
    chunk_files: int = 1000

    def __post_init__(self) -> None:
        """Refuse limits that no file keeps; ValueError naming them."""
        if not min(self.data_mb, self.video_mb, self.video_s, self.chunk_files) > 0:
            raise ValueError(f"limits of files must be more than 0, got {self}")

    def place(self, number: int) -> tuple[int, int]:
        """Return (chunk index, file index) of the ``number``-th file of a kind."""
        return divmod(number, self.chunk_files)

    def path(self, root: Path, template: str, number: int, **keys: str) -> Path:
        """Return the path of the ``number``-th file of a kind and make its folder."""
        chunk, file = self.place(number)
        path = root / template.format(chunk_index=chunk, file_index=file, **keys)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def write_json(value: Any, path: Path) -> None:
    """Write JSON the way LeRobot does, so that a later edit by its tools shows only what it
    changed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False))
