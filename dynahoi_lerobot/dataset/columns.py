"""The frame table: LeRobot's description of its columns, their arrow types, its rows and reading them."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from PIL import Image

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.features import IMAGE_PREFIX, Feature
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.dataset.language import ARROW, HUGGING_FACE, INFO, LANGUAGE

Features = dict[str, dict[str, Any]]

BOOKKEEPING = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""LeRobot's own columns."""


def info_features(held: Sequence[Feature], encoding: Encoding, *, subtasks: bool = False) -> Features:
    """Return ``info.json``'s feature table: the columns of the frame table, then LeRobot's own.

    Args:
        held: the columns, see ``features.frame_features``.
        encoding: how images are stored.
        subtasks: whether to include LeRobot's language column.
    """
    features = {feature.key: _info(feature, encoding) for feature in held}
    features |= {key: {"dtype": dtype, "shape": [1], "names": None} for key, dtype in BOOKKEEPING.items()}
    return features | ({LANGUAGE: dict(INFO)} if subtasks else {})


def _info(feature: Feature, encoding: Encoding) -> dict[str, Any]:
    entry = {"dtype": feature.dtype, "shape": list(feature.column_shape), "names": list(feature.names)}
    if not feature.is_image:
        return entry
    if not encoding.make_codec().is_video:
        return entry | {"dtype": "image"}
    return entry | {"dtype": "video", "info": encoding.make_codec().info(feature.shape[0], CONTROL_HZ)}


def image_keys(features: Features) -> list[str]:
    """Return the keys of all images, those of the hand's camera first."""
    return [key for key in features if key.startswith(IMAGE_PREFIX)]


def numeric_keys(features: Features) -> list[str]:
    """Return the keys of all columns that hold numbers, in the dataset's order."""
    return [
        key for key, feature in features.items() if feature["dtype"] not in ("video", "image", "string", "language")
    ]


def content_keys(features: Features) -> list[str]:
    """Return the keys of the numeric columns that an episode fills, without LeRobot's bookkeeping."""
    return [key for key in numeric_keys(features) if key not in BOOKKEEPING]


def bookkeeping_arrays(frames: int, episode_index: int, first_index: int, task_index: int) -> dict[str, np.ndarray]:
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
    """Return the schema of the data files, with the note from which ``datasets`` reads its feature types."""
    stored = {key: feature for key, feature in features.items() if feature["dtype"] != "video"}
    note = {"info": {"features": {key: _hf_type(feature) for key, feature in stored.items()}}}
    fields = [pa.field(key, _arrow_type(feature)) for key, feature in stored.items()]
    return pa.schema(fields, metadata={"huggingface": json.dumps(note)})


def frame_table(
    arrays: dict[str, np.ndarray], images: dict[str, np.ndarray], schema: pa.Schema, subtasks: pa.Array | None = None
) -> pa.Table:
    """Return one episode's rows.

    Args:
        arrays: (T, D) or (T,) per key.
        images: (T, H, W, 3) uint8 RGB per key; none where images do not go into the table.
        schema: what ``arrow_schema`` returned.
        subtasks: what ``language_column`` returned, if the schema has that column.
    """
    columns = {key: _images(pixels) for key, pixels in images.items()}
    columns |= {key: _array(arrays[key], schema.field(key).type) for key in schema.names if key in arrays}
    columns |= {} if subtasks is None else {LANGUAGE: subtasks}
    return pa.table([columns[key] for key in schema.names], schema=schema)


def column_array(table: pa.Table, key: str) -> np.ndarray:
    """Return a numeric column as (n, D); LeRobot's own tools write lists that are not of a fixed size."""
    column = table[key].combine_chunks()
    rows = len(column)
    if pa.types.is_fixed_size_list(column.type) or pa.types.is_list(column.type):
        column = column.flatten()
    return column.to_numpy(zero_copy_only=False).reshape(rows, -1 if rows else 1)  # (n, D)


def _array(values: np.ndarray, kind: pa.DataType) -> pa.Array:
    flat = np.ascontiguousarray(values).reshape(-1)  # (T * D,)
    if not pa.types.is_fixed_size_list(kind):
        return pa.array(flat, kind)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat, kind.value_type), kind.list_size)


def _images(images: np.ndarray) -> pa.Array:
    cells = [{"bytes": _png(image), "path": f"frame-{number:06d}.png"} for number, image in enumerate(images)]
    return pa.array(cells, _IMAGE)


def _png(image: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", compress_level=6)
    return buffer.getvalue()


_IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_SCALARS = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}


def _arrow_type(feature: dict[str, Any]) -> pa.DataType:
    if feature["dtype"] == "image":
        return _IMAGE
    if feature["dtype"] == "language":
        return ARROW
    scalar, width = _SCALARS[feature["dtype"]], feature["shape"][0]
    return scalar if width == 1 else pa.list_(scalar, width)


def _hf_type(feature: dict[str, Any]) -> dict[str, Any]:
    if feature["dtype"] == "image":
        return {"_type": "Image"}
    if feature["dtype"] == "language":
        return HUGGING_FACE
    scalar, width = {"dtype": feature["dtype"], "_type": "Value"}, feature["shape"][0]
    return scalar if width == 1 else {"feature": scalar, "length": width, "_type": "List"}
