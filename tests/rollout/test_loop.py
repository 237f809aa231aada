"""The one loop: order, retries, memory and what each actor gets to see."""

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.core.agent import Agent, Expert, Observation, WorldState
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.rollout.loop import ActionLog, evaluate, play, record, replay
from dynahoi_lerobot.rollout.recorder import Job
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import digest

QUICK = Recipe.of(split="val", motions=("constant", "bounce", "lateral"), image_size=0)
SEEING = changed(QUICK, {"image_size": 32})
SEEDS = (0, 1, 2, 5, 4, 10)


class Clumsy(Expert):
    """Misses seeds 1 and 4 once, seed 5 twice, seed 2 always."""

    name = "clumsy"
    retries = 3
    misses = {1: 1, 4: 1, 5: 2, 2: 4}  # noqa: RUF012 - never changed

    def __init__(self) -> None:
        self._expert = Intercept()

    def act(self, world: WorldState) -> np.ndarray:
        commands = self._expert.act(world)
        for i, spec in enumerate(world.specs):
            if spec is not None and world.attempt[i] <= self.misses.get(spec.seed, 0):
                commands[i] = world.observation.state[i]
        return commands


class Remembering(Agent):
    """Creeps upwards, and keeps what it was shown since the last reset."""

    name = "remembering"

    def __init__(self, *, sees_images: bool = False) -> None:
        self.sees_images = sees_images
        self.resets: list[int] = []
        self.shown: list[list[Observation]] = []

    def reset(self, count: int) -> None:
        self.resets.append(count)
        self.shown.append([])

    def act(self, observation: Observation) -> np.ndarray:
        self.shown[-1].append(observation)
        commands = observation.state.astype(np.float64)
        commands[:, 2] += 0.01
        return commands


@pytest.fixture
def clumsy(monkeypatch: pytest.MonkeyPatch) -> Recording:
    EXPERTS.names()  # so that the registry is complete before one is added
    monkeypatch.setitem(EXPERTS._entries, "clumsy", Clumsy)
    return Recording(QUICK, expert="clumsy")


@pytest.mark.parametrize("batch_size", [3, 32])
def test_failed_attempts_are_retried_and_successes_come_in_the_order_of_the_seeds(
    clumsy: Recording, batch_size: int
):
    episodes = list(record(clumsy, SEEDS, batch_size=batch_size, threads=1))
    assert [(e.meta.seed, e.meta.attempts) for e in episodes] == [
        (0, 1),
        (1, 2),
        (5, 3),
        (4, 2),
        (10, 1),
    ]
    assert all(episode.success for episode in episodes)


def test_recordings_are_the_same_whatever_the_batch():
    one_by_one = record(Recording(QUICK), range(6), batch_size=1, threads=1)
    together = record(Recording(QUICK), range(6), batch_size=4, threads=2)
    recordings = [[digest(episode) for episode in episodes] for episodes in (one_by_one, together)]
    assert recordings[0] == recordings[1]
    assert len(recordings[0]) == 6


def test_recordings_end_soon_after_the_catch_and_have_images():
    for episode in record(Recording(SEEING), range(3), threads=1):
        assert episode.localized.sum() == 11
        assert list(episode.images) == ["ego"]
        assert episode.images["ego"].shape == (len(episode), 32, 32, 3)
        assert episode.images["ego"].dtype == np.uint8


@pytest.mark.parametrize("capture", ["attach", "contact"])
def test_a_recording_plays_again_from_the_commands_given(capture: str):
    pushed = Recording.of(capture=capture, image_size=0, perturbed_share=1.0)
    for episode in record(pushed, range(4), threads=1):
        log = ActionLog(episode.meta.seed, episode.given_action, episode.meta.attempts)
        (again,) = replay(pushed.recipe, [log], images=False)
        np.testing.assert_allclose(again.state, episode.state, atol=1e-6)
        assert capture == "contact" or np.abs(episode.action - episode.given_action).max() > 0.01


def test_an_agent_is_reset_before_each_group_and_sees_it_from_its_first_frame(
    specs: list[EpisodeSpec],
):
    agent = Remembering()
    batch = WorldBatch(QUICK.rules, 3, threads=1)
    jobs = (
        Job(i, spec, frames)
        for i, (spec, frames) in enumerate(zip(specs, (12, 10, 14, 9, 11), strict=False))
    )
    played = dict(play(batch, agent, jobs))
    assert agent.resets == [3, 3], "five jobs in three worlds are two groups"
    assert [len(shown) for shown in agent.shown] == [14, 11], (
        "a group lasts as long as its longest job"
    )
    assert sorted(job.index for job in played) == [0, 1, 2, 3, 4]
    for job, episode in played.items():
        assert len(episode) == job.frames
        shown = agent.shown[job.index // 3]
        np.testing.assert_array_equal(shown[0].state[job.index % 3, :3], 0)
        np.testing.assert_array_equal(
            episode.state, [o.state[job.index % 3] for o in shown[: job.frames]]
        )


@pytest.mark.parametrize("sees_images", [False, True])
def test_an_agent_is_shown_observations_and_nothing_else(
    specs: list[EpisodeSpec], sees_images: bool
):
    agent = Remembering(sees_images=sees_images)
    episodes = list(evaluate(WorldBatch(SEEING.rules, 2, threads=1), agent, specs[:2]))
    for shown in agent.shown[0]:
        assert type(shown) is Observation
        assert shown.state.shape == (2, 18)
        assert list(shown.images) == ["ego"] * sees_images
        assert shown.tasks == (specs[0].task, specs[1].task)
        assert shown.environment_state is None, "the truth is shown on request alone"
    assert all(list(episode.images) == ["ego"] * sees_images for episode in episodes)
    assert {episode.meta.agent for episode in episodes} == {"remembering"}


def test_an_agent_cannot_change_the_world_through_what_it_is_shown(specs: list[EpisodeSpec]):
    batch = WorldBatch(SEEING.rules, 1, threads=1)
    batch.reset([0], specs[:1])
    before = batch._batch.state.copy()
    observation = batch.observe(images=True)
    for values in (observation.state, observation.phase, observation.images["ego"]):
        values[:] = 7
    np.testing.assert_array_equal(batch._batch.state, before)
    assert not (batch.observe(images=True).images["ego"] == 7).all()


@pytest.mark.parametrize(("spare", "localized"), [(0, True), (-1, False)])
def test_the_outcome_of_the_last_of_l_steps_counts(spare: int, localized: bool):
    spec = sample_specs(QUICK, SEEDS[:1])[0]
    (first,) = evaluate(WorldBatch(QUICK.rules, 1), Intercept(), [spec])
    short = replace(spec, length_frames=first.first_localized - spec.window_frames + spare)
    (episode,) = evaluate(WorldBatch(QUICK.rules, 1), Intercept(), [short])
    assert METRICS["S_loc"](episode) == float(localized)
    assert METRICS["R_time"](episode) == 0.0, "the last moment is no better than never"
    assert len(episode) == short.window_frames + short.length_frames + 1
    if localized:
        assert METRICS["E_loc"](episode) == METRICS["E_loc"](first)


def test_who_needs_images_is_not_played_without_a_camera(specs: list[EpisodeSpec]):
    with pytest.raises(ValueError, match="'remembering' needs images"):
        next(
            evaluate(
                WorldBatch(QUICK.rules, 1, threads=1), Remembering(sees_images=True), specs[:1]
            )
        )
