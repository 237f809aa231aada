"""Recordings show what the environment shows: the same commands, given to it, the same pixels."""

from collections.abc import Iterable
from itertools import batched
from typing import Any

import numpy as np
import pytest

from dynahoi_lerobot.core.agent import Agent, Observation
from dynahoi_lerobot.core.conventions import DETECTOR_IMAGE_SIZE_PX
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import ENVIRONMENT_STATES
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES, PROTOCOLS
from dynahoi_lerobot.env import DynahoiVectorEnv
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.renderers.views import EXTRA_VIEWS, OPTIONAL_VIEWS
from dynahoi_lerobot.rollout.loop import record, record_on_policy
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe

SPLITS = ("val", "ood_motion")
"""Their motions are all that the benchmark has."""
TOGETHER = 8


def differing(recipe: Recipe, episodes: Iterable[Episode]) -> list[str]:
    """Return the recorded images that are not those of an environment that is given the commands,
    which plays several episodes together and one after the other.
    """
    env = DynahoiVectorEnv(TOGETHER, recipe=recipe, autoreset_mode="Disabled")
    found = []
    for group in batched(episodes, TOGETHER):
        seeds = [episode.meta.seed for episode in group]
        shown, _ = env.reset(seed=seeds + [0] * (TOGETHER - len(group)))
        commands = np.zeros((TOGETHER, *env.single_action_space.shape), np.float32)
        for frame in range(max(map(len, group))):
            for i, episode in enumerate(group):
                if frame >= len(episode):
                    continue
                for view, images in episode.images.items():
                    if not np.array_equal(images[frame], shown["pixels"][view][i]):
                        found.append(f"{episode.meta.motion} {view} {frame}")
                commands[i] = episode.given_action[frame]
            shown, *_ = env.step(commands)
    env.close()
    return found


def recording_of(split: str, **values: Any) -> Recording:
    return Recording.of(**{"split": split, "image_size": 32, "perturbed_share": 1.0} | values)


def recorded(recording: Recording) -> list[Episode]:
    return list(record(recording, range(len(recording.recipe.motion_names))))


@pytest.mark.parametrize("capture", ["attach", "contact"])
@pytest.mark.parametrize("split", SPLITS)
def test_recordings_of_the_expert_show_what_the_environment_shows(split: str, capture: str):
    recording = recording_of(split, capture=capture, views=EXTRA_VIEWS)
    episodes = recorded(recording)
    assert {episode.meta.motion for episode in episodes} == set(BENCHMARK.splits[split].motions)
    assert split == "ood_motion" or max(episode.meta.attempts for episode in episodes) > 1
    assert not differing(recording.recipe, episodes)


def test_every_view_at_once_shows_what_the_environment_shows():
    recording = recording_of("val", views=OPTIONAL_VIEWS, motions=("planar", "conical", "bounce"))
    assert not differing(recording.recipe, recorded(recording))


class Wanderer(Agent):
    """A policy that has nothing to do with the target, with or without eyes."""

    def __init__(self, *, sees_images: bool) -> None:
        self.sees_images = sees_images
        self._rng = np.random.default_rng(0)

    def act(self, observation: Observation) -> np.ndarray:
        state = observation.state.astype(np.float64)
        state[:, :3] += self._rng.normal(0.0, 0.02, (len(state), 3))
        return state


@pytest.mark.parametrize("sees_images", [False, True])
def test_recordings_of_a_policy_show_what_the_environment_shows(sees_images: bool):
    recording = recording_of("val", actor="wanderer@0123456789abcdef", motions=("damped", "lob"))
    made = record_on_policy(
        recording, range(4), make_agent=lambda _: Wanderer(sees_images=sees_images)
    )
    assert not differing(recording.recipe, made)


VARIED = {
    **{f"hand {name}": {"hand": name} for name in HANDS.names()},
    **{f"protocol {name}": {"protocol": name} for name in PROTOCOLS},
    **{f"control {name}": {"control_class": name} for name in CONTROL_CLASSES},
    **{f"state {name}": {"environment_state": name} for name in ENVIRONMENT_STATES},
}


@pytest.mark.nightly
@pytest.mark.parametrize("capture", ["attach", "attach_lenient", "contact"])
@pytest.mark.parametrize("varied", VARIED.values(), ids=VARIED)
def test_any_rules_show_what_the_environment_shows(varied: dict[str, str], capture: str):
    size = DETECTOR_IMAGE_SIZE_PX if "environment_state" in varied else 32
    recording = recording_of("val", capture=capture, views=("side",), image_size=size, **varied)
    assert not differing(recording.recipe, recorded(recording))
