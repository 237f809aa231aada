"""The per-frame columns: LeRobot's feature table, the arrow schema, an episode's arrays by key."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from PIL import Image

from dynahoi_lerobot.dataset.codecs.base import Encoding
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.features import PICTURE_PREFIX, TOUCH, columns
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ

Features = dict[str, dict[str, Any]]

BOOKKEEPING = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""LeRobot's own columns."""


def info_features(
    image_size: int | None, encoding: Encoding, views: Sequence[str] = (), *, touch: bool = False
) -> Features:
    """Return ``info.json``'s feature table: every column of the spec, then LeRobot's own."""
    features: Features = {}
    for column in columns(image_size, views, touch=touch):
        features[column.key] = {
            "dtype": column.dtype,
            "shape": list(column.shape),
            "names": list(column.names),
        }
    codec = encoding.make_codec()
    for key in picture_keys(features):
        features[key]["dtype"] = "video" if codec.is_video else "image"
        if codec.is_video:
            features[key]["info"] = codec.info(features[key]["shape"][0], CONTROL_HZ)
    return features | {key: {"dtype": dtype, "shape": [1], "names": None} for key, dtype in BOOKKEEPING.items()}


def picture_keys(features: Features) -> list[str]:
    """Return the keys of all pictures, the hand's camera first."""
    return [key for key in features if key.startswith(PICTURE_PREFIX)]


def numeric_keys(features: Features) -> list[str]:
    """Return the keys of all columns that hold numbers, in the dataset's order."""
    return [key for key, feature in features.items() if feature["dtype"] not in ("video", "image", "string")]


def content_keys(features: Features) -> list[str]:
    """Return the keys of the numeric columns that an episode fills, without LeRobot's bookkeeping."""
    return [key for key in numeric_keys(features) if key not in BOOKKEEPING]


def picture_arrays(episode: Episode) -> dict[str, np.ndarray]:
    """Return the episode's pictures under their keys, (T, H, W, 3) uint8 each."""
    return {PICTURE_PREFIX + view: images for view, images in episode.pictures.items()}


def content_arrays(episode: Episode) -> dict[str, np.ndarray]:
    """Return the episode's numeric columns under their keys, each (T, D)."""
    frames = len(episode)
    touch = {} if episode.touch is None else {TOUCH.key: episode.touch}
    return touch | {
        "observation.state": episode.state,
        "observation.fingertips": episode.fingertips,
        "observation.phase": episode.phase,
        "action": episode.action,
        "target.pose": episode.target_pose,
        "target.velocity": episode.target_velocity,
        "target.contacts": episode.target_contacts,
        "intercept.position": np.tile(np.float32(episode.intercept_position), (frames, 1)),
        "intercept.time": np.full((frames, 1), episode.intercept_time, np.float32),
        "localized": episode.localized[:, None],
        "captured": episode.captured[:, None],
    }


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


def frame_table(arrays: dict[str, np.ndarray], pictures: dict[str, np.ndarray], schema: pa.Schema) -> pa.Table:
    """Return one episode's rows.

    Args:
        arrays: (T, D) or (T,) per key.
        pictures: (T, H, W, 3) uint8 RGB per key; none where pictures do not go into the table.
        schema: what ``arrow_schema`` returned.
    """
    columns = [
        _pictures(pictures[field.name]) if field.type == _PICTURE else _array(arrays[field.name], field.type)
        for field in schema
    ]
    return pa.table(columns, schema=schema)


def _array(values: np.ndarray, kind: pa.DataType) -> pa.Array:
    flat = np.ascontiguousarray(values).reshape(-1)  # (T * D,)
    if not pa.types.is_fixed_size_list(kind):
        return pa.array(flat, kind)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat, kind.value_type), kind.list_size)


def _pictures(images: np.ndarray) -> pa.Array:
    cells = [{"bytes": _png(image), "path": f"frame-{number:06d}.png"} for number, image in enumerate(images)]
    return pa.array(cells, _PICTURE)


def _png(image: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", compress_level=6)
    return buffer.getvalue()


_PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_SCALARS = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}


def _arrow_type(feature: dict[str, Any]) -> pa.DataType:
    if feature["dtype"] == "image":
        return _PICTURE
    scalar, width = _SCALARS[feature["dtype"]], feature["shape"][0]
    return scalar if width == 1 else pa.list_(scalar, width)


def _hf_type(feature: dict[str, Any]) -> dict[str, Any]:
    if feature["dtype"] == "image":
        return {"_type": "Image"}
    scalar, width = {"dtype": feature["dtype"], "_type": "Value"}, feature["shape"][0]
    return scalar if width == 1 else {"feature": scalar, "length": width, "_type": "List"}
