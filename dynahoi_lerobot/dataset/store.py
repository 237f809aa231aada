"""A dataset on disk, read without LeRobot."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import CAMERA_KEY, EPISODE_TABLE_PREFIX, IMAGE_PREFIX
from dynahoi_lerobot.dataset.columns import Features, image_keys
from dynahoi_lerobot.dataset.episode_arrays import content_values
from dynahoi_lerobot.dataset.episode_table import ARRAY_COLUMNS, EpisodeRow, own_values
from dynahoi_lerobot.dataset.files import reading
from dynahoi_lerobot.dataset.paths import DATA_PATH, INFO_PATH, TASKS_PATH, VIDEO_PATH
from dynahoi_lerobot.dataset.tables import read_tasks
from dynahoi_lerobot.dataset.video import decode


class Store:
    """Lazy access to a dataset's tables and frames."""

    def __init__(self, root: Path) -> None:
        """Look at the dataset below ``root``.

        Raises:
            FileNotFoundError: if there is none.
        """
        self.root = root
        if not (root / INFO_PATH).is_file():
            raise FileNotFoundError(f"{root} is no LeRobot dataset: {INFO_PATH} is missing")

    @cached_property
    def info(self) -> dict[str, Any]:
        """The content of ``info.json``.

        Raises:
            ValueError: if it is damaged.
        """
        with reading(path := self.root / INFO_PATH):
            info = json.loads(path.read_text())
            if not isinstance(info["features"], dict):
                raise TypeError("its features are not a JSON object")
            return info

    @property
    def features(self) -> Features:
        """The feature table."""
        return self.info["features"]

    @property
    def pictures(self) -> list[str]:
        """The keys of all images, those of the hand's camera first."""
        return image_keys(self.features)

    @property
    def has_video(self) -> bool:
        """Whether images are stored as video."""
        return self.features.get(CAMERA_KEY, {}).get("dtype") == "video"

    @cached_property
    def tasks(self) -> list[str]:
        """The instructions, by task index."""
        return read_tasks(self.root / TASKS_PATH)

    @cached_property
    def rows(self) -> list[EpisodeRow]:
        """The episode table without its statistics, one dictionary per episode.

        Raises:
            ValueError: if a file of it is damaged, or there is none.
        """
        if not (paths := self.row_files()):
            raise ValueError(f"{self.root} holds no episode table: there is no file in meta/episodes")
        return pa.concat_tables([_rows(path) for path in paths]).to_pylist()

    @property
    def episodes(self) -> int:
        """Number of episodes in the episode table."""
        return len(self.rows)

    def row_files(self) -> list[Path]:
        """Return the files of the episode table, in order."""
        return sorted((self.root / "meta/episodes").glob("*/*.parquet"))

    def data_files(self) -> list[Path]:
        """Return the files of the frame table, in order."""
        return sorted((self.root / "data").glob("*/*.parquet"))

    def full_rows(self) -> Iterator[EpisodeRow]:
        """Yield the rows of the episode table with their statistics."""
        for path in self.row_files():
            yield from pq.read_table(path).to_pylist()

    def data_path(self, row: EpisodeRow) -> Path:
        """Return the file that holds the episode's rows."""
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        return self.root / DATA_PATH.format(**place)

    def video_path(self, row: EpisodeRow, key: str) -> Path:
        """Return the file that holds the episode's images of a view."""
        place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        return self.root / VIDEO_PATH.format(video_key=key, **place)

    def frames(self, row: EpisodeRow) -> pa.Table:
        """Return the episode's rows of the frame table.

        Raises:
            ValueError: if their file is missing or damaged.
        """
        with reading(path := self.data_path(row)):
            return pq.read_table(path, filters=[("episode_index", "=", row["episode_index"])])

    def images(self, row: EpisodeRow, table: pa.Table, key: str) -> np.ndarray:
        """Return the episode's images of a view, (T, H, W, 3) uint8 RGB."""
        if not self.has_video:
            cells = table[key].to_pylist()
            return np.stack([np.asarray(Image.open(io.BytesIO(cell["bytes"]))) for cell in cells])
        start = round(row[f"videos/{key}/from_timestamp"] * CONTROL_HZ)
        return np.stack(list(decode(self.video_path(row, key), start, start + row["length"])))

    def episode(self, index: int, *, images: bool = True) -> Episode:
        """Return one episode; ``images`` says whether to decode its images.

        Raises:
            IndexError: if there is no such episode.
        """
        if not 0 <= index < self.episodes:
            raise IndexError(f"episode {index} does not exist; {self.root} holds {self.episodes}")
        row = self.rows[index]
        table = self.frames(row)
        keys = self.pictures if images else []
        views = {key.removeprefix(IMAGE_PREFIX): self.images(row, table, key) for key in keys}
        values = own_values(row)
        return Episode(images=views, **values, **content_values(table, values))


def _rows(path: Path) -> pa.Table:
    """Return a file of the episode table without the statistics."""
    with reading(path):
        names = pq.read_schema(path).names
        columns = [name for name in names if name in ARRAY_COLUMNS or not name.startswith(EPISODE_TABLE_PREFIX)]
        return pq.read_table(path, columns=columns)
