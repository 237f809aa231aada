"""A dataset on disk, read without LeRobot, which only ``open_dataset`` imports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import IMAGE_PREFIX
from dynahoi_lerobot.core.lerobot_internals import video_backend_unspoken
from dynahoi_lerobot.core.reading import (
    ReadError,
    open_table,
    read_object,
    read_rows,
    reading,
    regular,
    require,
)  # fmt: skip
from dynahoi_lerobot.core.working_folder import workspace_path
from dynahoi_lerobot.dataset.columns import (
    Features,
    Table,
    column_array,
    content_values,
    image_keys,
    numeric_keys,
    read_png,
    video_keys,
)
from dynahoi_lerobot.dataset.episode_table import (
    FRAME_RANGE,
    STATS_PREFIX,
    EpisodeRow,
    own_values,
    row_schema,
)  # fmt: skip
from dynahoi_lerobot.dataset.manifest import check_schema
from dynahoi_lerobot.dataset.paths import DATA_PATH, INFO_PATH, TASKS_PATH, VIDEO_PATH, check_root
from dynahoi_lerobot.dataset.privileged import Privileged, PrivilegedTables
from dynahoi_lerobot.dataset.video import Encoding, decode

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

PLACE = (
    "episode_index",
    "length",
    "dataset_from_index",
    "dataset_to_index",
    "data/chunk_index",
    "data/file_index",
)
"""Columns of the episode table that say where an episode lies."""


def open_dataset(root: Path, **options: Any) -> LeRobotDataset:
    """Open the dataset with LeRobot; ``options`` go to ``LeRobotDataset`` (``delta_timestamps``,
    ``episodes``).

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
        ReadError: if LeRobot would read what is no file of it, or cannot read it.
        ValueError: if LeRobot cannot open this path, or reads another number of rows than its
            episodes have.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    check_root(root)
    store = Store(root)
    store.check_files()
    with reading(root), video_backend_unspoken():
        dataset = LeRobotDataset(f"local/{root.name}", root=root, **options)
    lengths = [row["length"] for row in store.rows]
    chosen = range(len(lengths)) if dataset.episodes is None else dataset.episodes
    n_rows = dataset.hf_dataset.num_rows
    n_frames = sum(lengths[index] for index in chosen)
    if n_rows != n_frames:
        raise ValueError(
            f"LeRobot reads {n_rows} rows of {root}; its episodes have {n_frames}; see `dynahoi "
            f"verify`"
        )
    return dataset


def read_episodes(
    root: Path, indices: Iterable[int] | None = None, *, images: bool = True
) -> Iterator[Episode]:
    """Yield episodes of a dataset that this project wrote.

    Args:
        root: the dataset's folder.
        indices: which episodes, all by default.
        images: False leaves the images undecoded; episodes then have none.

    Raises:
        IndexError: if the dataset has no episode of an index.
        ReadError: if a file is missing or damaged, as after an edit by LeRobot's tools, which drop
            the privileged tables.
    """
    store = Store(root)
    some = (store.stored(index) for index in indices or ())
    for stored in store.stored_episodes() if indices is None else some:
        yield store.as_episode(stored, images=images)


def frame_column(root: Path, key: str) -> np.ndarray:
    """Return a column of a dataset with one row per frame: row i belongs to the frame of global
    index i.

    This is how a policy in training finds what it must not see, such as the target's pose:
    LeRobot's preprocessing passes the ``index`` of a batch's frames on (and their
    ``episode_index``), but drops every column besides observations and actions. Read the column
    once and look frames up: ``frame_column(root, "target.pose")[index]``. A million frames take
    less than half a second.

    Args:
        root: the dataset's folder, ``meta.root`` of LeRobot's metadata.
        key: name of a column of the frame table or of the privileged tables. What has one value per
            episode is repeated for each of its frames.

    Returns:
        (N, D) in the column's unit, of its element type.

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if the dataset has no such column of numbers, or not as many rows as frames.
    """
    store = Store(root)
    if key in numeric_keys(store.features):
        return store.frame_columns([key])[key]
    feature = store.privileged.feature(key)
    if feature.is_ragged:
        raise ValueError(f"{root} has no column {key!r} with a row per frame")
    if feature.per == "frame":
        return store.privileged.rows(feature)
    return np.repeat(episode_column(root, key), store.lengths, axis=0)


def episode_column(root: Path, key: str) -> list[np.ndarray]:
    """Return a privileged array, one item an episode: item i belongs to ``episode_index`` i.

    Unlike ``frame_column``, it also reads arrays whose number of rows is not the number of frames,
    such as ``target_path``: the target's untouched path, beyond the end of the recording.

    Args:
        root: the dataset's folder.
        key: name of a column of the privileged tables.

    Returns:
        Per episode (D,) what is constant, else (rows, D), in the column's unit, of its element
        type.

    Raises:
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if the dataset has no such array.
    """
    store = Store(root)
    feature = store.privileged.feature(key)
    if feature.per == "frame":
        return np.split(store.privileged.rows(feature), np.cumsum(store.lengths)[:-1])
    return store.privileged.cells(feature)


@dataclass(frozen=True)
class StoredEpisode:
    """One episode as the tables hold it.

    Attributes:
        row: its row of the episode table; with its statistics only where all episodes are read.
        frames: its rows of the frame table.
        privileged: its rows of the privileged tables.
    """

    row: EpisodeRow
    frames: pa.Table
    privileged: Privileged


class Store:
    """Lazy access to a dataset's tables and frames."""

    def __init__(self, root: Path) -> None:
        """Look at the dataset below ``root``; FileNotFoundError if there is none."""
        self.root = root
        if not (root / INFO_PATH).exists():
            workspace = workspace_path(root)
            hint = f"; repeat the command that is making it in {workspace}"
            raise FileNotFoundError(
                f"{root} is no LeRobot dataset: {INFO_PATH} is missing{hint * workspace.is_dir()}"
            )

    @cached_property
    def info(self) -> dict[str, Any]:
        """The content of ``info.json``; ValueError if it is damaged, or the manifest names another
        schema than the one that is read here.
        """
        check_schema(self.root)
        path = self.root / INFO_PATH
        info = read_object(path, {"features": dict[str, dict[str, Any]]})
        with reading(path):
            for key, entry in info["features"].items():
                if "/" in key:
                    raise ValueError(f"no column can have the name {key!r}")
                require(entry, {"dtype": str, "shape": list[int]})
        return info

    @property
    def fps(self) -> float:
        """Frames per second; ValueError if ``info.json`` gives no usable rate."""
        path = self.root / INFO_PATH
        with reading(path):
            require(self.info, {"fps": float})
        if not 1 <= self.info["fps"] <= 1000:
            raise ReadError(f"{path} says fps is {self.info['fps']!r}; it must be 1 to 1000")
        return self.info["fps"]

    def check_files(self) -> None:
        """Refuse a dataset of which LeRobot would open another file than its own, or one too large
        for memory.
        """
        for name, usual in (("data_path", DATA_PATH), ("video_path", VIDEO_PATH)):
            template = self.info.get(name)
            if template not in (usual, None):
                raise ReadError(
                    f"{self.root / INFO_PATH} says {name} is {template!r}; it must be {usual!r}"
                )
        for path in self.tables():
            open_table(path).close()
        for path in (self.root / "meta").glob("*.json"):
            regular(path)
        for path in self.root.glob("videos/*/*/*"):
            regular(path)
        total = sum(row["length"] for row in self.rows)
        if total != self.frame_count:
            raise ReadError(
                f"{self.root} has {self.frame_count} frames, and episodes of {total}; see "
                f"`dynahoi verify`"
            )

    @cached_property
    def data(self) -> Table:
        """The frame table; ValueError if there is none."""
        return self._table("data", "frame table")

    @cached_property
    def episode_table(self) -> Table:
        """The episode table; ValueError if there is none."""
        return self._table("meta/episodes", "episode table")

    def _table(self, folder: str, name: str) -> Table:
        table = Table(self.root / folder)
        if not table.files:
            raise ValueError(f"{self.root} holds no {name}: there is no file in {folder}")
        return table

    @property
    def frame_count(self) -> int:
        """Number of rows of the frame table."""
        return int(self.data.ends[-1])

    @property
    def features(self) -> Features:
        """The feature table."""
        return self.info["features"]

    @property
    def image_keys(self) -> list[str]:
        """The keys of all images, the hand's camera first."""
        return image_keys(self.features)

    @property
    def video_keys(self) -> list[str]:
        """The keys of the images that are stored as video."""
        return video_keys(self.features)

    @property
    def encoding(self) -> Encoding:
        """How images are stored, as the feature table records it; as video where there are none."""
        if not self.video_keys:
            return Encoding("images" if self.image_keys else "h264")
        info = self.features[self.video_keys[0]]["info"]
        return Encoding("h264", info["video.crf"], info["video.preset"], info["video.g"])

    @cached_property
    def tasks(self) -> list[str]:
        """The instructions in the table's order, by which LeRobot finds them."""
        schema = pa.schema({"task": pa.string()})
        return [row["task"] for row in read_rows(self.root / TASKS_PATH, schema)]

    @cached_property
    def rows(self) -> list[EpisodeRow]:
        """The episode table without what lies below ``stats/``, one dictionary per episode.

        Raises:
            ValueError: if a file of it is damaged, or there is none.
        """
        rows = [row for path in self.episode_table.files for row in self._read_rows(path)]
        first = 0
        for index, row in enumerate(rows):
            stop = first + (row["length"] or 0)
            place = (row["episode_index"], row["dataset_from_index"], row["dataset_to_index"])
            if place != (index, first, stop) or not first < stop <= self.frame_count:
                words = ", ".join(f"{name} {row[name]}" for name in PLACE[:4])
                raise ReadError(
                    f"{self.root} places episode {index} at {words}, of {self.frame_count} frames"
                )
            first = stop
        return rows

    def _read_rows(self, path: Path, *, statistics: bool = False) -> Iterator[EpisodeRow]:
        """Yield the rows of a file of the episode table: what `row_schema` names and the file has,
        in its types; LeRobot's tools write other numeric and list types.
        """
        schema = row_schema(self.features)
        with open_table(path) as file:
            own = [name for name in schema.names if name in file.schema_arrow.names]
        names = [name for name in own if statistics or not name.startswith(STATS_PREFIX)]
        fields = [schema.field(name) for name in dict.fromkeys((*PLACE, "tasks", *names))]
        return read_rows(path, pa.schema(fields))

    @property
    def episodes(self) -> int:
        """Number of episodes in the episode table."""
        return len(self.rows)

    @property
    def lengths(self) -> np.ndarray:
        """Number of frames of each episode, (E,), as the episode table says: the frames need not be
        here, as where LeRobot fetches some episodes, or streams them.
        """
        (lengths,) = self.episode_table.columns(["length"])
        return lengths[:, 0]

    def tables(self) -> list[Path]:
        """Return the files of all tables; ValueError if LeRobot has no episodes or frames to
        read.
        """
        tables = (self.episode_table, self.data, self.privileged.frames, self.privileged.episodes)
        return [self.root / TASKS_PATH, *(path for table in tables for path in table.files)]

    @cached_property
    def privileged(self) -> PrivilegedTables:
        """The privileged tables."""
        return PrivilegedTables(self.root, lambda: self.lengths)

    def frame_columns(self, keys: Sequence[str]) -> dict[str, np.ndarray]:
        """Return numeric columns of the frame table by key, (N, D) each, in the order of the
        frames.

        Raises:
            ValueError: if a file is missing or damaged, or the frames lie in another order.
        """
        names = [*{"index", *keys}]
        columns = dict(zip(names, self.data.columns(names), strict=True))
        index = columns["index"]
        if not np.array_equal(index[:, 0], np.arange(len(index))):
            raise ValueError(f"{self.root} holds its frames in another order; see `dynahoi verify`")
        return {key: columns[key] for key in keys}

    def full_rows(self) -> Iterator[EpisodeRow]:
        """Yield the rows of the episode table with their statistics."""
        for path in self.episode_table.files:
            yield from self._read_rows(path, statistics=True)

    def data_path(self, row: EpisodeRow) -> Path:
        """Return the file that holds the episode's rows."""
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        return self.root / DATA_PATH.format(**place)

    def video_path(self, row: EpisodeRow, key: str) -> Path:
        """Return the file that holds the episode's images of a view."""
        place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        return self.root / VIDEO_PATH.format(video_key=key, **place)

    def frames(self, row: EpisodeRow) -> pa.Table:
        """Return the episode's rows of the frame table; ReadError if they do not lie, all of them
        and in order, in the file that the row names.
        """
        first = row["dataset_from_index"]
        stop = row["dataset_to_index"]
        path = self.data_path(row)
        with reading(path):
            table = self.data.rows(first, stop)
            index = column_array(table, "index")[:, 0]
            if path != self.data.file(first) or not np.array_equal(index, np.arange(first, stop)):
                raise ReadError(
                    f"{path} does not hold the frames of episode {row['episode_index']} in their "
                    f"order"
                )
        return table

    def images(self, row: EpisodeRow, table: pa.Table, key: str) -> np.ndarray:
        """Return the episode's images of a view, (T, H, W, 3) uint8 RGB."""
        is_video = key in self.video_keys
        path = self.video_path(row, key) if is_video else self.data_path(row)
        with reading(path):
            if is_video:
                start = round(row[f"videos/{key}/from_timestamp"] * self.fps)
                frames = decode(path, start, start + row["length"])
            else:
                frames = (read_png(cell) for cell in table[key].to_pylist())
            shape = (row["length"], *self.features[key]["shape"])
            images = np.empty(shape, np.uint8)
            for place, image in zip(range(row["length"]), frames, strict=True):
                if image.shape != shape[1:]:
                    raise ValueError(
                        f"it shows an image of shape {image.shape}; {self.root / INFO_PATH} says "
                        f"{shape[1:]}"
                    )
                images[place] = image
            return images

    def row(self, index: int) -> EpisodeRow:
        """Return one of ``rows``; IndexError if there is no such episode."""
        if not 0 <= index < self.episodes:
            raise IndexError(f"episode {index} does not exist; {self.root} holds {self.episodes}")
        return self.rows[index]

    def stored(self, index: int) -> StoredEpisode:
        """Return an episode as the tables hold it; IndexError if there is no such episode."""
        return self._stored(self.row(index))

    def _stored(self, row: EpisodeRow) -> StoredEpisode:
        place = (row[name] for name in ("episode_index", *FRAME_RANGE))
        return StoredEpisode(row, self.frames(row), self.privileged.episode(*place))

    def as_episode(self, stored: StoredEpisode, *, images: bool) -> Episode:
        """Return the Episode that the tables hold, with its images or without."""
        keys = self.image_keys if images else []
        views = {
            key.removeprefix(IMAGE_PREFIX): self.images(stored.row, stored.frames, key)
            for key in keys
        }
        with reading(self.root):
            return Episode(
                images=views,
                **own_values(stored.row),
                **stored.privileged.values(),
                **content_values(stored.frames, self.features),
            )

    def stored_episodes(self) -> Iterator[StoredEpisode]:
        """Yield every episode; each file is read once.

        Raises:
            ValueError: if a file is missing or damaged.
        """
        if self.rows:  # which are checked
            yield from map(self._stored, self.full_rows())
