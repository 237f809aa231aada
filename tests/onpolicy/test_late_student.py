"""Each episode has a latency of its own, and a chunk continues what is executed until it is ready."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynahoi_lerobot.core.agent import Observation
from dynahoi_lerobot.core.rules import one_hot_phase
from dynahoi_lerobot.onpolicy.late_student import LateStudent
from dynahoi_lerobot.onpolicy.recipe import DaggerRecipe, StudentInference, read_recipe
from tests.onpolicy.test_dagger import tiny_recipe


def frame(t: int, worlds: int) -> Observation:
    rng = np.random.default_rng(t)
    images = {"ego": rng.integers(0, 255, (worlds, 32, 32, 3), dtype=np.uint8)}
    state = np.tile(np.linspace(0.01, 0.1, 18, dtype=np.float32), (worlds, 1))
    acting = one_hot_phase(np.ones(worlds, bool))
    return Observation(images, state, acting, ("",) * worlds)


def test_chunks_of_different_latencies_each_begin_with_their_own_old_chunk(tmp_path: Path):
    from lerobot_policy_tracker.learner import make_learner

    learner = make_learner(read_recipe(DaggerRecipe, tiny_recipe(tmp_path)))
    student = LateStudent(learner, StudentInference("async", (0.0, 370.0)), np.random.default_rng(1))
    student.reset(4)
    delays = list(student._delays)
    assert len(set(delays)) > 1
    given, planned = [], {}
    for t in range(30):
        given.append(student.act(frame(t, 4)))
        for i, chunk in enumerate(student._coming):
            if chunk is not None and chunk.first == t > delays[i]:
                planned[i, t] = chunk.actions
    assert planned
    for (i, t), actions in planned.items():
        if t + delays[i] <= len(given):
            executed = np.stack([commands[i] for commands in given[t : t + delays[i]]])
            np.testing.assert_allclose(actions[: delays[i]], executed, atol=1e-6)
    assert learner._lead_frames.tolist() == [delay + delay // 2 for delay in delays]


def test_corrected_commands_are_those_of_the_policy_for_what_each_chunk_expected(tmp_path: Path):
    from lerobot_policy_tracker.learner import make_learner

    learner = make_learner(read_recipe(DaggerRecipe, tiny_recipe(tmp_path)))
    timing = StudentInference("async", (100.0, 370.0), corrected=True)
    student = LateStudent(learner, timing, np.random.default_rng(1))
    student.reset(4)
    for t in range(20):
        commands = student.act(frame(t, 4))
        running = {i: chunk for i, chunk in enumerate(student._running) if chunk is not None}
        for i, chunk in running.items():
            action = learner.policy.corrected_action([i], [chunk.expectation], [t - chunk.first])
            np.testing.assert_allclose(commands[i], learner.postprocess(action).numpy()[0], atol=1e-6)
    assert len(running) == 4
    assert len({t - chunk.first for chunk in running.values()}) > 1, "chunks of different ages"
