"""Write episodes as a LeRobotDataset v3.0. The same episodes give the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import Feature
from dynahoi_lerobot.core.rules import is_acting
from dynahoi_lerobot.dataset.card.readme import finish_with_card
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.dataset.columns import arrow_schema, bookkeeping_arrays, frame_table, image_keys, info_features
from dynahoi_lerobot.dataset.episode_arrays import check_fits, content_arrays, image_arrays
from dynahoi_lerobot.dataset.episode_table import HISTOGRAM, EpisodeRow, own_columns, stats_columns, video_columns
from dynahoi_lerobot.dataset.language import language_column, subtask_rows
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.metadata import MetadataWriter
from dynahoi_lerobot.dataset.paths import DATA_PATH, VIDEO_PATH, FileLimits
from dynahoi_lerobot.dataset.statistics import (
    picture_histogram,
    picture_stats,
    sampled_frames,
    table_stats,
)
from dynahoi_lerobot.dataset.tables import MIB, RollingParquet
from dynahoi_lerobot.dataset.video import VideoWriter


class DatasetWriter:
    """Writes a dataset into a new folder.

    Until ``finish`` returns, the folder is not a dataset: write into a temporary one and rename it.
    """

    def __init__(
        self,
        root: Path,
        features: Sequence[Feature],
        encoding: Encoding | None = None,
        limits: FileLimits | None = None,
        *,
        subtasks: bool = False,
    ) -> None:
        """Make the folder ``root``.

        Args:
            root: a path that does not exist yet; its parent does.
            features: the columns that every episode fills, see ``features.frame_features``.
            encoding: how images are stored.
            limits: file size limits.
            subtasks: whether to write subtasks as LeRobot's column for language.

        Raises:
            FileExistsError: if ``root`` exists.
            ValueError: if video cannot hold images of this size.
        """
        self.encoding, self.limits = encoding or Encoding(), limits or FileLimits()
        self._codec = self.encoding.make_codec()
        self._features = tuple(features)
        self._image_size = max((feature.shape[0] for feature in features if feature.is_image), default=0)
        if self._codec.is_video and self._image_size % 2:
            raise ValueError(f"image size is {self._image_size} pixels; video needs an even number")
        root.mkdir()
        self.root = root
        info, self._subtasks = info_features(features, self.encoding, subtasks=subtasks), subtasks
        self._keys = image_keys(info)
        self._schema = arrow_schema(info)
        self._catalog = MetadataWriter(root, info, self.limits)
        self._data = RollingParquet(root, DATA_PATH, self._schema, self.limits)
        self._videos: dict[str, VideoWriter] = {}
        """The file of each view that is being written; all of them begin and end with the same episodes."""
        self._n_videos = 0
        self._seeds: list[int] = []

    @property
    def episodes(self) -> int:
        """How many episodes have been added."""
        return self._catalog.episodes

    def add(self, episode: Episode) -> None:
        """Append one episode.

        Raises:
            ValueError: if it has other columns than the dataset, or images of another size.
        """
        check_fits(episode, self._features)
        arrays = content_arrays(episode, self._features)
        row = own_columns(episode, arrays) | {"tasks": [episode.meta.task], "length": len(episode)}
        row |= stats_columns(table_stats(arrays)) | self._image_columns(episode)
        row |= self._write_frames(episode, arrays)
        if self._keys and self._codec.is_video:
            row |= self._write_videos(episode)
        self._catalog.add(row)
        self._seeds.append(episode.meta.seed)

    def finish(self, provenance: dict[str, Any] | None = None, yields: dict[str, int] | None = None) -> Manifest:
        """Close every file, write the tables under ``meta/`` and the card, and return the manifest, also written.

        Raises:
            ValueError: if no episode was added.
        """
        if not self._catalog.episodes:
            raise ValueError("no episode was added; a dataset needs at least one")
        self._data.close()
        self._close_videos()
        self._catalog.finish()
        manifest = Manifest(
            self._catalog.episodes,
            self._catalog.frames,
            hash_files(self.root),
            self._seeds,
            provenance or {},
            yields or {},
            self._catalog.benchmark,
        )
        return finish_with_card(self.root, manifest)

    def abandon(self) -> None:
        """Close all files and leave the folder unfinished."""
        for video in self._videos.values():
            video.abandon()

    def _image_columns(self, episode: Episode) -> EpisodeRow:
        sample, arrays, columns = sampled_frames(len(episode)), image_arrays(episode), EpisodeRow()
        for key in self._keys:
            images = arrays[key] if len(sample) == len(episode) else arrays[key][sample]
            histogram = picture_histogram(images)
            columns |= {HISTOGRAM + key: histogram.reshape(-1).tolist()}  # (3 * 256,)
            columns |= stats_columns({key: picture_stats(histogram, len(sample))})
        return columns

    def _write_frames(self, episode: Episode, arrays: dict[str, np.ndarray]) -> EpisodeRow:
        place = self._catalog.next_place(episode.meta.task)
        bookkeeping = bookkeeping_arrays(len(episode), *place)
        images = {} if self._codec.is_video else image_arrays(episode)
        subtasks = None
        if self._subtasks:
            subtasks = language_column(subtask_rows(is_acting(episode.phase), episode.localized), len(episode))
        table = frame_table(arrays | bookkeeping, images, self._schema, subtasks)
        chunk, file = self._data.write(table)
        return {"data/chunk_index": chunk, "data/file_index": file}

    def _write_videos(self, episode: Episode) -> EpisodeRow:
        if not all(self._fits(video, len(episode)) for video in self._videos.values()):
            self._close_videos()
        if not self._videos:
            self._open_videos()
        start = self._videos[self._keys[0]].frames
        for key, images in image_arrays(episode).items():
            self._videos[key].write(images)
        chunk, file = self.limits.place(self._n_videos - 1)
        place = {
            "chunk_index": chunk,
            "file_index": file,
            "from_timestamp": start / CONTROL_HZ,
            "to_timestamp": (start + len(episode)) / CONTROL_HZ,
        }
        return video_columns(self._keys, place)

    def _open_videos(self) -> None:
        for key in self._keys:
            path = self.limits.path(self.root, VIDEO_PATH, self._n_videos, video_key=key)
            self._videos[key] = VideoWriter(path, self._image_size, CONTROL_HZ, self.encoding)
        self._n_videos += 1

    def _close_videos(self) -> None:
        for video in self._videos.values():
            video.close()
        self._videos = {}

    def _fits(self, video: VideoWriter, frames: int) -> bool:
        expected_bytes = video.size_bytes * (1 + frames / video.frames)
        return expected_bytes < self.limits.video_mb * MIB and video.frames + frames <= self.limits.video_s * CONTROL_HZ
