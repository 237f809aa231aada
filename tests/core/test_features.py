"""One feature table: a new entry is found in spaces, env config, recordings, datasets and documentation."""

from __future__ import annotations

from dataclasses import fields
from math import prod

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.renderers.views import VIEWS


def test_every_array_of_an_episode_is_in_the_table_and_nothing_else() -> None:
    arrays = {field.name for field in fields(Episode) if "ndarray" in str(field.type) or field.type == "float"}
    assert arrays == {name for name, feature in FEATURES.items() if not feature.derived} | {"images"}
    assert all(isinstance(getattr(Episode, name), property) for name, f in FEATURES.items() if f.derived)


def test_observations_hold_what_policies_may_see() -> None:
    observed = {feature.name for feature in FEATURES.values() if feature.observed}
    assert {field.name for field in fields(Observation)} == {*observed, "images", "tasks"}


def test_no_privileged_feature_is_called_an_observation() -> None:
    for feature in FEATURES.values():
        assert (feature.gym_key is None) == (not feature.observed and feature.name != "action"), feature.name


def test_elements_are_named_and_keys_are_unique() -> None:
    assert all(len(feature.names) == prod(feature.column_shape) for feature in FEATURES.values())
    assert len({feature.key for feature in FEATURES.values()}) == len(FEATURES)
    gym_keys = [feature.gym_key for feature in FEATURES.values() if feature.gym_key]
    assert len(set(gym_keys)) == len(gym_keys)


def test_the_hands_camera_is_the_first_view() -> None:
    assert next(iter(VIEWS)) == EGO_CAMERA == "ego"
