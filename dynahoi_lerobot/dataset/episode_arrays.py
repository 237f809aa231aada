"""Convert between an Episode's attributes and a dataset's columns, following the feature table."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import IMAGE_PREFIX, Feature, episode_features, frame_features, image_feature
from dynahoi_lerobot.dataset.columns import column_array


def features_of(episode: Episode) -> tuple[Feature, ...]:
    """Return the columns of the frame table that the episode fills, in the dataset's order."""
    images = (image_feature(view, frames.shape[1]) for view, frames in episode.images.items())
    return (*images, *_held(episode))


def image_arrays(episode: Episode) -> dict[str, np.ndarray]:
    """Return the episode's images under their keys, (T, H, W, 3) uint8 each."""
    return {IMAGE_PREFIX + view: frames for view, frames in episode.images.items()}


def content_arrays(episode: Episode, features: Sequence[Feature] | None = None) -> dict[str, np.ndarray]:
    """Return the episode's numeric columns under their keys, each (T, D).

    Args:
        episode: the episode.
        features: which columns, images left out; by default all that it holds without being asked.
    """
    chosen = _held(episode) if features is None else [feature for feature in features if not feature.is_image]
    return {feature.key: _column(feature, episode) for feature in chosen}


def content_values(table: pa.Table, known: Container[str] = ()) -> dict[str, Any]:
    """Return the attributes of an Episode that its rows of the frame table hold: undoes ``content_arrays``.

    Those that follow from others are left out, and those that are ``known`` from elsewhere.

    Raises:
        KeyError: if a column is missing that every dataset has.
    """
    every, present = frame_features(0, contact_sensors=True, on_policy=True), table.column_names
    held = (feature for feature in every if feature.key in present or not feature.optional)
    read = (feature for feature in held if not feature.derived and feature.name not in known)
    return {feature.name: _value(feature, column_array(table, feature.key)) for feature in read}


def check_fits(episode: Episode, features: Sequence[Feature]) -> None:
    """Refuse an episode with other columns.

    Raises:
        ValueError: naming the column, what the episode has and what the dataset needs.
    """
    frames = len(episode)
    in_rows = [feature for feature in episode_features() if feature.has_fixed_shape]
    stored = [feature for feature in features if not feature.on_request]
    wanted = {feature.key: feature.array_shape(frames) for feature in (*stored, *in_rows)}
    keys = {feature.key for feature in features}
    held = (*(f for f in _held(episode) if f.key in keys or not f.movable), *in_rows)
    found = {feature.key: np.shape(getattr(episode, feature.name)) for feature in held}
    found |= {key: images.shape for key, images in image_arrays(episode).items()}
    for key in (*wanted, *found):
        if wanted.get(key) != found.get(key):
            raise ValueError(
                f"the episode of seed {episode.meta.seed} has {_described(key, found)}, the dataset needs "
                f"{_described(key, wanted)}; all episodes of a dataset must have the same columns"
            )


def _held(episode: Episode) -> list[Feature]:
    every = frame_features(0, contact_sensors=True, on_policy=True)
    return [feature for feature in every if getattr(episode, feature.name) is not None]


def _column(feature: Feature, episode: Episode) -> np.ndarray:
    """Return one attribute as (T, D)."""
    frames, value = len(episode), np.asarray(getattr(episode, feature.name), feature.dtype)
    return np.tile(value.reshape(1, -1), (frames, 1)) if feature.constant else value.reshape(frames, -1)


def _value(feature: Feature, column: np.ndarray) -> Any:
    """Return the attribute from its column (T, D)."""
    values = column.reshape(len(column), *feature.shape)
    if not feature.constant:
        return values
    return values[0] if feature.shape else values[0].item()


def _described(key: str, shapes: dict[str, tuple[int, ...]]) -> str:
    return f"{key} of shape {shapes[key]}" if key in shapes else f"no {key}"
