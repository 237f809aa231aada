"""One feature table: a new entry is found in spaces, env config, recordings, datasets and documentation."""

from __future__ import annotations

from dataclasses import fields, make_dataclass
from math import prod
from pathlib import Path

import numpy as np
import pytest
from lerobot_env_dynahoi import DynahoiEnvConfig

from dynahoi_lerobot.cli.listing import LISTS
from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES, Feature
from dynahoi_lerobot.dataset import read_episodes, store, write_episodes
from dynahoi_lerobot.env import DynahoiVectorEnv
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.renderers.views import VIEWS
from dynahoi_lerobot.rollout import recorder
from dynahoi_lerobot.world.batch import WorldBatch

WIND = Feature("wind", "observation.wind", (2,), ("x", "y"), "m/s", "wind", gym_key="wind", low=-3.0, high=3.0)
HEAT = Feature("heat", "world.heat", (), ("heat",), "K", "temperature of the air")


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


@pytest.fixture
def two_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Enter an observed and a privileged feature: the attributes, what computes them, and one entry each."""
    windy = make_dataclass("Windy", [("wind", np.ndarray, None)], bases=(Observation,), frozen=True, eq=False)
    added = [("wind", np.ndarray, None), ("heat", np.ndarray, None)]
    longer = make_dataclass("Longer", added, bases=(Episode,), frozen=True, eq=False)
    observe = WorldBatch.observe

    def observe_wind(batch: WorldBatch, **options) -> Observation:
        return windy(
            **vars(observe(batch, **options)),
            wind=np.stack([batch.frame, -batch.frame], axis=1).astype(np.float32) / 10,
        )

    monkeypatch.setattr(WorldBatch, "observe", observe_wind)
    monkeypatch.setattr(recorder, "Episode", longer)
    monkeypatch.setattr(store, "Episode", longer)
    monkeypatch.setitem(recorder.MEASURED, "heat", lambda batch: 290.0 + batch.frame)
    monkeypatch.setitem(FEATURES, "wind", WIND)
    monkeypatch.setitem(FEATURES, "heat", HEAT)


@pytest.mark.usefixtures("two_more")
def test_one_entry_is_enough_for_spaces_config_recording_dataset_and_reader(tmp_path: Path) -> None:
    kept = []
    env = DynahoiVectorEnv(1, kind="constant", image_size=0, on_episode=kept.append)
    observation, _ = env.reset(seed=0)
    while not kept:
        assert env.observation_space.contains(observation)
        observation = env.step(observation["agent_pos"])[0]
    assert "heat" not in observation
    assert np.abs(observation["wind"]).max() <= 3.0
    (episode,) = kept
    np.testing.assert_array_equal(episode.heat, 290.0 + np.arange(len(episode)))
    write_episodes(tmp_path / "d", [episode])
    (read,) = read_episodes(tmp_path / "d")
    for name in ("wind", "heat"):
        np.testing.assert_array_equal(getattr(read, name), getattr(episode, name))
    described = store.Store(tmp_path / "d").features
    assert described["observation.wind"] == {"dtype": "float32", "shape": [2], "names": ["x", "y"]}
    config = DynahoiEnvConfig(image_size=16)
    assert (config.features["wind"].shape, config.features_map["wind"]) == ((2,), "observation.wind")
    assert "heat" not in config.features
    rows = {row["dataset"]: row["gymnasium"] for row in LISTS["features"]()}
    assert (rows["observation.wind"], rows["world.heat"]) == ("wind", "privileged")
