"""DatasetWriter: episodes in, a LeRobotDataset v3.0 out. The same episodes give the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.conventions import CONTROL_HZ
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.generate.catalog import Catalog
from dynahoi_lerobot.generate.codecs.base import Encoding
from dynahoi_lerobot.generate.features import (
    arrow_schema,
    bookkeeping_arrays,
    content_arrays,
    frame_table,
    info_features,
)
from dynahoi_lerobot.generate.layout import DATA_PATH, VIDEO_PATH, Layout
from dynahoi_lerobot.generate.manifest import Manifest, hash_files
from dynahoi_lerobot.generate.rows import HISTOGRAM, Row, own_columns, stats_columns
from dynahoi_lerobot.generate.statistics import (
    picture_histogram,
    picture_stats,
    sampled_frames,
    table_stats,
)
from dynahoi_lerobot.generate.tables import MIB, RollingParquet
from dynahoi_lerobot.generate.video import VideoWriter
from dynahoi_lerobot.spec import CAMERA_KEY


class DatasetWriter:
    """Writes a dataset into a new folder.

    Until ``finish`` returns, the folder is not a dataset: write into a temporary one and rename it.
    """

    def __init__(
        self,
        root: Path,
        image_size: int | None,
        encoding: Encoding | None = None,
        layout: Layout | None = None,
        *,
        touch: bool = False,
    ) -> None:
        """Make the folder ``root``.

        Args:
            root: a path that does not exist yet; its parent does.
            image_size: side of the square frames [pixels], None for a dataset without a camera.
            encoding: how pictures are stored.
            layout: file size limits.
            touch: whether episodes hold the fingers' forces.

        Raises:
            FileExistsError: if ``root`` exists.
            ValueError: if video cannot hold frames of this size.
        """
        self.encoding, self.layout = encoding or Encoding(), layout or Layout()
        self._codec = self.encoding.kind
        self._image_size = image_size
        if image_size is not None and self._codec.is_video and image_size % 2:
            raise ValueError(f"image size is {image_size} pixels; video needs an even number")
        root.mkdir()
        self.root = root
        features = info_features(image_size, self.encoding, touch=touch)
        self._schema = arrow_schema(features)
        self._catalog = Catalog(root, features, self.layout)
        self._data = RollingParquet(root, DATA_PATH, self._schema, self.layout)
        self._video: VideoWriter | None = None
        self._videos = 0
        self._seeds: list[int] = []

    @property
    def episodes(self) -> int:
        """How many episodes have been added."""
        return self._catalog.episodes

    def add(self, episode: Episode) -> None:
        """Append one episode.

        Raises:
            ValueError: if its images are missing or of another size than the dataset's.
        """
        self._check(episode)
        arrays = content_arrays(episode)
        row = own_columns(episode) | {"tasks": [episode.meta.task], "length": len(episode)}
        row |= stats_columns(table_stats(arrays)) | self._picture_columns(episode)
        row |= self._write_frames(episode, arrays)
        if episode.images is not None and self._image_size is not None and self._codec.is_video:
            row |= self._write_video(episode.images, self._image_size)
        self._catalog.add(row)
        self._seeds.append(episode.meta.seed)

    def finish(self, provenance: dict[str, Any] | None = None, yields: dict[str, int] | None = None) -> Manifest:
        """Close every file, write the tables under ``meta/`` and return the manifest, also written there.

        Raises:
            ValueError: if no episode was added.
        """
        if not self._catalog.episodes:
            raise ValueError("no episode was added; a dataset holds one or more")
        self._data.close()
        if self._video is not None:
            self._video.close()
        self._catalog.finish()
        manifest = Manifest(
            self._catalog.episodes,
            self._catalog.frames,
            hash_files(self.root),
            self._seeds,
            provenance or {},
            yields or {},
        )
        manifest.write(self.root)
        return manifest

    def abandon(self) -> None:
        """Let go of all files; the folder stays as it is, unfinished."""
        if self._video is not None:
            self._video.abandon()

    def _check(self, episode: Episode) -> None:
        if self._image_size is None:
            return
        wanted = (len(episode), self._image_size, self._image_size, 3)
        found = None if episode.images is None else episode.images.shape
        if found != wanted:
            raise ValueError(
                f"episode of seed {episode.meta.seed} has images of shape {found}; the dataset needs {wanted}"
            )

    def _picture_columns(self, episode: Episode) -> Row:
        if self._image_size is None or episode.images is None:
            return {}
        sample = sampled_frames(len(episode))
        images = episode.images if len(sample) == len(episode) else episode.images[sample]
        histogram = picture_histogram(images)
        counts = {HISTOGRAM: histogram.reshape(-1).tolist()}  # (3 * 256,)
        return counts | stats_columns({CAMERA_KEY: picture_stats(histogram, len(sample))})

    def _write_frames(self, episode: Episode, arrays: dict[str, np.ndarray]) -> Row:
        place = self._catalog.next_place(episode.meta.task)
        bookkeeping = bookkeeping_arrays(len(episode), *place)
        images = None if self._codec.is_video else episode.images
        table = frame_table(arrays | bookkeeping, images, self._schema)
        chunk, file = self._data.write(table)
        return {"data/chunk_index": chunk, "data/file_index": file}

    def _write_video(self, images: np.ndarray, image_size: int) -> Row:
        video = self._video_with_room(len(images), image_size)
        start = video.frames
        video.write(images)
        chunk, file = self.layout.place(self._videos - 1)
        cells = {
            "chunk_index": chunk,
            "file_index": file,
            "from_timestamp": start / CONTROL_HZ,
            "to_timestamp": video.frames / CONTROL_HZ,
        }
        return {f"videos/{CAMERA_KEY}/{name}": value for name, value in cells.items()}

    def _video_with_room(self, frames: int, image_size: int) -> VideoWriter:
        video = self._video
        if video is not None and not self._fits(video, frames):
            video.close()
            video = None
        if video is None:
            path = self.layout.path(self.root, VIDEO_PATH, self._videos, video_key=CAMERA_KEY)
            video = VideoWriter(path, image_size, CONTROL_HZ, self.encoding)
            self._videos += 1
        self._video = video
        return video

    def _fits(self, video: VideoWriter, frames: int) -> bool:
        expected_bytes = video.size_bytes * (1 + frames / video.frames)
        return expected_bytes < self.layout.video_mb * MIB and video.frames + frames <= self.layout.video_s * CONTROL_HZ
