"""``next.reward``, ``next.done`` and ``next.success`` mean what LeRobot's reinforcement learning takes them for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.policies.tdmpc.configuration_tdmpc import TDMPCConfig
from lerobot.rl.buffer import ReplayBuffer

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset import open_dataset, write_episodes
from tests.synthetic import synthetic_episode

STATE = "observation.state"


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> tuple[Path, list[Episode]]:
    """A caught and a missed target."""
    episodes = [synthetic_episode(0, image_size=None), synthetic_episode(1, image_size=None, miss_m=0.2)]
    assert [episode.success for episode in episodes] == [True, False]
    root = tmp_path_factory.mktemp("stored") / "d"
    write_episodes(root, episodes)
    return root, episodes


def test_the_replay_buffer_gets_a_reward_per_success_and_an_end_per_episode(stored) -> None:
    root, episodes = stored
    transitions = ReplayBuffer._lerobotdataset_to_transitions(open_dataset(root), [STATE])
    ends = np.cumsum([len(episode) for episode in episodes]) - 1
    assert np.flatnonzero([t["done"] for t in transitions]).tolist() == ends.tolist()
    (rewarded,) = np.flatnonzero([t["reward"] for t in transitions])
    first = episodes[0].first_localized
    after = torch.tensor(episodes[0].state[first])
    assert rewarded == first - 1, "the action that leads to success"
    assert torch.equal(transitions[rewarded]["next_state"][STATE][0], after)
    assert not transitions[rewarded]["done"]


def test_the_reward_has_a_next_observation_which_tdmpc_needs(stored) -> None:
    root, _ = stored
    config = TDMPCConfig()
    steps = {"next.reward": config.reward_delta_indices, STATE: config.observation_delta_indices}
    opened = open_dataset(root, delta_timestamps={key: [step / 20 for step in deltas] for key, deltas in steps.items()})
    learnt = [(item["next.reward"] * ~item[f"{STATE}_is_pad"][1:]).sum().item() for item in opened]
    assert sum(learnt) == config.horizon, "each place within the horizon, as its loss masks padding"


def test_the_columns_are_those_of_lerobots_own_recordings(stored) -> None:
    from lerobot.scripts.lerobot_eval import _env_features_to_dataset_features

    features = open_dataset(stored[0]).meta.features
    for key, theirs in _env_features_to_dataset_features({}).items():
        assert (features[key]["dtype"], tuple(features[key]["shape"])) == (theirs["dtype"], theirs["shape"]), key
