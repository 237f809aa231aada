"""The frame table: LeRobot's description of its columns, their arrow types, its rows, and reading
them back.
"""

import io
import json
from collections.abc import Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from PIL import Image

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import (
    FEATURES,
    IMAGE_PREFIX,
    TOLD_APART,
    Feature,
    action_feature,
    image_feature,
)
from dynahoi_lerobot.core.protocols import is_acting
from dynahoi_lerobot.core.reading import open_table, read_table
from dynahoi_lerobot.dataset.video import MAX_PIXELS, Encoding

Features = dict[str, dict[str, Any]]
"""The feature table of ``info.json``."""

BOOKKEEPING = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""LeRobot's own columns."""

LANGUAGE = "language_persistent"
"""LeRobot's name of the column of subtasks. All rows of an episode stand in each of its frames;
which of them is active is found by their timestamps
(``lerobot.datasets.language_render.active_at``)."""
SUBTASKS = (
    "watch the target",
    "reach and intercept the target",
    "close the hand and hold the target",
)


def dataset_features(episode: Episode) -> tuple[Feature, ...]:
    """Return the columns that a dataset of such episodes has, in its order: of the frame table, or
    of the privileged tables.
    """
    images = (image_feature(view, frames.shape[1]) for view, frames in episode.images.items())
    told = FEATURES | {"action": action_feature(episode.meta.control_mode)}
    arrays = (feature for feature in told.values() if not feature.rules_decide)
    return (*images, *(feature for feature in arrays if getattr(episode, feature.name) is not None))


def described_features(table: Features) -> dict[str, Feature]:
    """Return the columns of the frame table that ``info.json`` describes by their keys, in order,
    without LeRobot's.
    """
    views = {
        key: image_feature(key.removeprefix(IMAGE_PREFIX), table[key]["shape"][0])
        for key in image_keys(table)
    }
    stored = (f for f in TOLD_APART if f.key in table and not f.privileged)
    return views | {f.key: f for f in stored if table[f.key]["names"] == [*f.names]}


def info_features(
    features: Sequence[Feature], encoding: Encoding, *, subtasks: bool = False
) -> Features:
    """Return ``info.json``'s feature table: a dataset's columns of the frame table, then LeRobot's
    own.
    """
    table = {
        feature.key: _info(feature, encoding) for feature in features if not feature.privileged
    }
    table |= {
        key: {"dtype": dtype, "shape": [1], "names": None} for key, dtype in BOOKKEEPING.items()
    }
    return table | (
        {LANGUAGE: {"dtype": "language", "shape": [1], "names": None}} if subtasks else {}
    )


def _info(feature: Feature, encoding: Encoding) -> dict[str, Any]:
    entry = {
        "dtype": feature.dtype,
        "shape": list(feature.column_shape),
        "names": list(feature.names),
    }
    if not feature.is_image:
        return entry
    if feature.measures or not encoding.is_video:
        return entry | {"dtype": "image"}
    return entry | {"dtype": "video", "info": encoding.info(feature.shape[0])}


def image_keys(features: Features) -> list[str]:
    """Return the keys of all images, the hand's camera first."""
    return [key for key in features if key.startswith(IMAGE_PREFIX)]


def video_keys(features: Features) -> list[str]:
    """Return the keys of the images that are stored as video."""
    return [key for key in image_keys(features) if features[key]["dtype"] == "video"]


def numeric_keys(features: Features) -> list[str]:
    """Return the keys of all columns that hold numbers, in the dataset's order."""
    return [key for key, entry in features.items() if entry["dtype"] in SCALARS]


def content_arrays(episode: Episode, features: Sequence[Feature]) -> dict[str, np.ndarray]:
    """Return the episode's numeric columns among ``features`` of the frame table under their keys,
    (T, D) each.
    """
    stored = (feature for feature in features if not (feature.is_image or feature.privileged))
    return {
        f.key: np.asarray(getattr(episode, f.name), f.dtype).reshape(len(episode), -1)
        for f in stored
    }


def content_values(table: pa.Table, described: Features) -> dict[str, Any]:
    """Return the attributes of an Episode that its rows of the frame table hold, which
    ``info.json`` describes.

    Raises:
        KeyError: if a column is missing.
    """
    stored = (f for f in described_features(described).values() if not (f.is_image or f.derived))
    return {f.name: column_array(table, f.key)[:, ... if f.shape else 0] for f in stored}


def bookkeeping_arrays(
    frames: int, episode_index: int, first_index: int, task_index: int
) -> dict[str, np.ndarray]:
    """Return LeRobot's own columns of one episode, each (T,); timestamps in [s]."""
    frame_index = np.arange(frames)
    return {
        "timestamp": (frame_index / CONTROL_HZ).astype(np.float32),
        "frame_index": frame_index,
        "episode_index": np.full(frames, episode_index),
        "index": first_index + frame_index,
        "task_index": np.full(frames, task_index),
    }


def arrow_schema(features: Features) -> pa.Schema:
    """Return the schema of the data files, with the note from which ``datasets`` reads its feature
    types.
    """
    kinds = {
        key: _arrow_type(feature)
        for key, feature in features.items()
        if feature["dtype"] != "video"
    }
    note = {"info": {"features": {key: _hf_type(kind) for key, kind in kinds.items()}}}
    return pa.schema(kinds, metadata={"huggingface": json.dumps(note)})


def frame_columns(
    episode: Episode, arrays: dict[str, np.ndarray], schema: pa.Schema
) -> dict[str, pa.Array]:
    """Return one episode's columns of the frame table, of which ``arrays`` are the numeric ones,
    without LeRobot's.
    """
    columns = {key: flat_array(values, schema.field(key).type) for key, values in arrays.items()}
    for view, images in episode.images.items():
        key = IMAGE_PREFIX + view
        if key in schema.names:
            columns[key] = pa.array(
                [_png_cell(image, number) for number, image in enumerate(images)], _IMAGE
            )
    if LANGUAGE in schema.names:
        rows = subtask_rows(is_acting(episode.phase), episode.localized)
        columns[LANGUAGE] = pa.array([rows] * len(episode), _LANGUAGE)
    return columns


def flat_array(values: np.ndarray, kind: pa.DataType) -> pa.Array:
    """Return an array of numbers, or of fixed-size lists of them at any depth, from (T, ...)."""
    if not pa.types.is_fixed_size_list(kind):
        return pa.array(np.ascontiguousarray(values).reshape(-1), kind)  # (T * D,)
    return pa.FixedSizeListArray.from_arrays(flat_array(values, kind.value_type), kind.list_size)


def column_array(table: pa.Table, key: str) -> np.ndarray:
    """Return a numeric column as (n, D); LeRobot's own tools write lists that are not of a fixed
    size.

    Raises:
        ValueError: if it holds anything but numbers, or rows of different lengths.
    """
    column = table[key].combine_chunks()
    values = column
    lengths: Any = [1]
    if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        values = column.flatten()
        lengths = pc.call_function("list_value_length", [column]).unique().to_pylist()
    if (
        not pa.types.is_primitive(values.type)
        or column.null_count
        or values.null_count
        or len(lengths) > 1
        or lengths == [0]
    ):
        raise ValueError(
            f"its column {key} is of type {column.type}; every row must hold the same number of "
            f"values"
        )
    width = -1 if len(column) else 1
    return values.to_numpy(zero_copy_only=False).reshape(len(column), width)  # (n, D)


class Table:
    """A table of several Parquet files, read by columns or by rows; the file that rows were read
    from last stays in memory.

    Attributes:
        files: its files, in order; none if there is no such table.
    """

    def __init__(self, folder: Path) -> None:
        """Look for the files in the chunks below ``folder``."""
        self.files = sorted(folder.glob("*/*.parquet"))
        self._read = lru_cache(maxsize=1)(read_table)

    @cached_property
    def ends(self) -> np.ndarray:
        """(n,) number of rows up to the end of each file."""
        return np.cumsum([open_table(path).metadata.num_rows for path in self.files])

    def names(self) -> set[str]:
        """Return the names of its columns; none if there is no such table."""
        return {name for path in self.files[:1] for name in open_table(path).schema_arrow.names}

    def columns(self, keys: Sequence[str]) -> list[np.ndarray]:
        """Return numeric columns, (n, D) each.

        Raises:
            ValueError: as ``column_array``, or if a file is missing or damaged.
        """
        tables = [read_table(path, keys) for path in self.files]
        return [np.concatenate([column_array(table, key) for table in tables]) for key in keys]

    def file(self, row: int) -> Path:
        """Return the file that holds a row."""
        return self.files[np.searchsorted(self.ends, row, side="right")]

    def rows(self, start: int, stop: int) -> pa.Table:
        """Return the rows ``start`` to ``stop`` (excluded), as far as they are in one file;
        ReadError if it is missing or damaged.
        """
        number = int(np.searchsorted(self.ends, start, side="right"))
        table = self._read(self.files[number])
        first = int(self.ends[number]) - len(table)
        return table.slice(start - first, stop - start).combine_chunks()


def subtask_rows(acting: np.ndarray, localized: np.ndarray) -> list[dict[str, Any]]:
    """Return the subtasks of an episode in LeRobot's form, each with the time [s] from which it is
    active.

    The hand watches the target while commands are void, then reaches for it while ``acting`` (T,)
    bool, and holds it from the first frame on which it is ``localized`` (T,) bool.
    """
    state = np.where(localized, 2, acting)  # (T,)
    begins = np.flatnonzero(np.diff(state, prepend=-1))
    rows = []
    for frame in begins:
        time_s = float(np.float32(frame / CONTROL_HZ))  # as in the column timestamp
        row = {
            "role": "assistant",
            "content": SUBTASKS[int(state[frame])],
            "style": "subtask",
            "timestamp": time_s,
            "camera": None,
            "tool_calls": None,
        }
        rows.append(row)
    return rows


def _png_cell(image: np.ndarray, number: int) -> dict[str, Any]:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", compress_level=6)
    return {"bytes": buffer.getvalue(), "path": f"frame-{number:06d}.png"}


def read_png(cell: dict[str, Any]) -> np.ndarray:
    """Return the image (H, W, 3) uint8 RGB of a cell of the frame table.

    Raises:
        ValueError: if it is too large, or holds more than pixels: other readers turn images by what
            it says.
    """
    image = Image.open(io.BytesIO(cell["bytes"]), formats=["PNG"])
    if image.width * image.height > MAX_PIXELS:
        raise ValueError(
            f"an image has {image.width} x {image.height} pixels, more than {MAX_PIXELS}"
        )
    pixels = np.asarray(image)  # after which all that it holds is known
    frames = getattr(image, "n_frames", 1)
    if image.mode != "RGB" or image.info or frames > 1:
        raise ValueError(
            f"an image is {image.mode} with {sorted(image.info)} in {frames} frames, not RGB alone"
        )
    return pixels


_IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
SCALARS = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
"""Element types of columns of numbers."""
_LANGUAGE = pa.list_(
    pa.struct(
        [
            ("role", pa.string()),
            ("content", pa.string()),
            ("style", pa.string()),
            ("timestamp", pa.float32()),
            ("camera", pa.string()),
            ("tool_calls", pa.list_(pa.string())),
        ]
    )
)


def _arrow_type(feature: dict[str, Any]) -> pa.DataType:
    if feature["dtype"] == "image":
        return _IMAGE
    if feature["dtype"] == "language":
        return _LANGUAGE
    scalar = SCALARS[feature["dtype"]]
    width = feature["shape"][0]
    return scalar if width == 1 else pa.list_(scalar, width)


def _hf_type(kind: pa.DataType) -> dict[str, Any]:
    """Return the type that ``datasets`` reads from the note in the parquet files."""
    if kind == _IMAGE:
        return {"_type": "Image"}
    if pa.types.is_struct(kind):
        return {field.name: _hf_type(field.type) for field in kind}
    if pa.types.is_fixed_size_list(kind):
        return {"feature": _hf_type(kind.value_type), "length": kind.list_size, "_type": "List"}
    if pa.types.is_list(kind):
        return {"feature": _hf_type(kind.value_type), "_type": "List"}
    return {"dtype": "float32" if kind == pa.float32() else str(kind), "_type": "Value"}
