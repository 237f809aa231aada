"""The benchmark through vla-eval's own runner."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from vla_eval.recording import NullEpisodeRecorder
from vla_eval.registry import resolve_import_string
from vla_eval.runners.sync_runner import SyncEpisodeRunner

from dynahoi_lerobot.adapters.vla_eval import DynahoiBenchmark
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.metrics import METRICS


class Server:
    """A model server in the same process: the expert, who knows the episode, or a hand that holds still."""

    def __init__(self, benchmark: DynahoiBenchmark, *, moves: bool) -> None:
        self.benchmark, self.moves, self.observations = benchmark, moves, []

    async def start_episode(self, payload: dict) -> None:
        self.task = payload["task"]

    async def act(self, observation: dict) -> dict:
        self.observations.append(observation)
        if not self.moves:
            return {"actions": observation["states"]}
        batch = self.benchmark._env._batch
        return {"actions": Intercept().act(batch.world_state(batch.observe(images=False)))[0]}

    async def end_episode(self, result: dict) -> None:
        self.result = result


def run(benchmark: DynahoiBenchmark, kind: str, *, moves: bool) -> Server:
    server = Server(benchmark, moves=moves)
    task = next(task for task in benchmark.get_tasks() if task["name"] == kind)
    runner = SyncEpisodeRunner()
    asyncio.run(runner.run_episode(benchmark, {**task, "episode_idx": 1}, server, recorder=NullEpisodeRecorder()))
    return server


def test_the_expert_succeeds_and_a_still_hand_does_not():
    benchmark = DynahoiBenchmark(image_size=32)
    caught, missed = run(benchmark, "planar", moves=True), run(benchmark, "planar", moves=False)
    assert caught.result["metrics"]["success"] is True
    assert caught.result["metrics"]["S_loc"] == 1.0
    assert missed.result["metrics"]["success"] is False
    assert missed.result["metrics"]["S_loc"] == 0.0
    assert missed.result["steps"] > caught.result["steps"]
    assert set(caught.result["metrics"]) - {"success"} <= set(METRICS.names())
    benchmark.cleanup()


def test_observations_follow_the_convention():
    benchmark = DynahoiBenchmark(image_size=32, kinds=["lob", "constant"])
    assert benchmark.get_tasks() == [
        {"name": "lob", "suite": "projectile"},
        {"name": "constant", "suite": "straight_line"},
    ]
    server = run(benchmark, "lob", moves=False)
    first = server.observations[0]
    assert first["images"]["ego"].shape == (32, 32, 3)
    assert first["images"]["ego"].dtype == np.uint8
    assert first["states"].shape == (18,)
    assert "Catch" in first["task_description"]
    assert server.task["name"] == "lob"
    np.testing.assert_array_equal(benchmark.get_hold_action({"actions": np.ones(18)})["actions"], 1.0)


@pytest.mark.parametrize("mode", ["cpu", "gpu"])
def test_it_renders_anywhere_and_is_found_by_its_name(mode: str):
    name = "dynahoi_lerobot.adapters.vla_eval:DynahoiBenchmark"
    assert resolve_import_string(name) is DynahoiBenchmark
    assert mode in DynahoiBenchmark.render_backends
    assert DynahoiBenchmark.configure_render(mode) == {}
