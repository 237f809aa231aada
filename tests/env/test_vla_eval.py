"""The benchmark through vla-eval's own runner, and the entry that it reads."""

import asyncio
import itertools
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from dynahoi_benchmark import DynahoiBenchmark
from obact_server import ObActModelServer
from vla_eval.benchmarks.base import Benchmark
from vla_eval.cli.config_loader import load_config
from vla_eval.cli.smoke import SmokeTest, run_validate, smoke_test_from_path
from vla_eval.config import DockerConfig, EvalConfig
from vla_eval.recording import NullEpisodeRecorder
from vla_eval.registry import resolve_import_string
from vla_eval.runners.sync_runner import SyncEpisodeRunner

from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import CATEGORIES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seeds
from tests.checkpoints import SHIPPED
from tests.docs.playing import check_installation


class Server:
    """A model server in the same process, which answers with the action of a function, (18,)."""

    def __init__(self, action: Callable[[dict], np.ndarray]) -> None:
        self.action = action
        self.observations: list[dict] = []
        self.actions: list[np.ndarray] = []

    async def start_episode(self, payload: dict) -> None:
        self.task = payload["task"]

    async def act(self, observation: dict) -> dict:
        self.observations.append(observation)
        self.actions.append(self.action(observation))
        return {"actions": self.actions[-1]}

    async def end_episode(self, result: dict) -> None:
        self.metrics = result["metrics"]


def run(benchmark: DynahoiBenchmark, kind: str, action: Callable[[dict], np.ndarray]) -> Server:
    """Let a server play an episode of a kind."""
    server = Server(action)
    (task,) = (task for task in benchmark.get_tasks() if task["name"] == kind)
    episode = SyncEpisodeRunner().run_episode(
        benchmark, {**task, "episode_idx": 1}, server, recorder=NullEpisodeRecorder()
    )
    asyncio.run(episode)
    return server


def test_a_server_sees_what_the_convention_says_and_catches_if_it_moves_as_the_expert_does():
    benchmark = DynahoiBenchmark(image_size=32, kinds=["lob", "planar"])
    assert benchmark.get_tasks() == [
        {"name": "lob", "suite": "projectile"},
        {"name": "planar", "suite": "pendulum"},
    ]

    def expert(_: dict) -> np.ndarray:
        batch = benchmark._env._batch
        return Intercept().act(batch.world_state(batch.observe(images=False)))[0]

    missed = run(benchmark, "planar", lambda seen: seen["states"])
    caught = run(benchmark, "planar", expert)
    first = missed.observations[0]
    assert (first["images"]["ego"].shape, first["images"]["ego"].dtype) == ((32, 32, 3), np.uint8)
    assert first["states"].shape == (18,)
    assert "Catch" in first["task_description"]
    assert missed.task["name"] == "planar"
    held = benchmark.get_hold_action({"actions": np.ones(18)})
    np.testing.assert_array_equal(held["actions"], 1.0)
    assert (caught.metrics["success"], caught.metrics["S_loc"]) == (True, 1.0)
    assert (missed.metrics["success"], missed.metrics["S_loc"]) == (False, 0.0)
    assert len(missed.observations) > len(caught.observations)
    assert set(caught.metrics) - {"success"} <= set(METRICS.names())
    benchmark.cleanup()


def test_how_fast_a_server_is_changes_nothing_that_obact_does(monkeypatch: pytest.MonkeyPatch):
    benchmark = DynahoiBenchmark(image_size=96, kinds=["constant"])
    played = []
    for delay_s in (0.05, 0.2):
        clock = itertools.count(100.0, delay_s)
        monkeypatch.setattr("time.monotonic", lambda clock=clock: next(clock))
        server = ObActModelServer(str(SHIPPED))
        assert server.chunk_size == 1, "it sees every step"

        def obact(seen: dict, server: ObActModelServer = server) -> np.ndarray:
            return server.predict(seen, SimpleNamespace())["actions"][0]

        played.append(run(benchmark, "constant", obact))
    prompt, slow = played
    np.testing.assert_array_equal(prompt.actions, slow.actions)
    assert prompt.metrics["S_loc"] == 1.0


def test_the_world_moves_on_while_a_server_infers():
    """It stands still while the queue of four is read, until the chunk before is used up, and then
    moves twice.
    """
    benchmark = DynahoiBenchmark(
        image_size=32, inference="async", latency_ms=100.0, n_action_steps=4
    )
    frames = []
    task = {"name": "constant", "episode_idx": 0}
    observation = benchmark.make_obs(benchmark.reset(task), task)
    for _ in range(12):
        frames.append(int(benchmark._env._batch.frame[0]))
        benchmark.step({"actions": observation["states"]})
    assert frames == [0, 0, 0, 1, 2, 2, 2, 3, 4, 4, 4, 5]
    assert benchmark.get_metadata()["max_steps"] == 2 * 256


ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "envs" / "vla_eval"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.name)
def test_the_harness_takes_the_config_and_every_episode_is_another_one(path: Path):
    test = smoke_test_from_path(path)
    assert isinstance(test, SmokeTest)
    assert test.category == "benchmark"
    assert run_validate([test]).status == "pass"
    docker = DockerConfig.from_dict(load_config(str(path))["docker"])
    assert Path(docker.build.dockerfile_path).resolve() == FOLDER / "Dockerfile"
    (only,) = load_config(str(path))["benchmarks"]
    config = EvalConfig.from_dict(only)
    benchmark: Benchmark = resolve_import_string(config.benchmark)(**config.params)
    tasks = benchmark.get_tasks()
    split = config.params["split"]
    assert {task["suite"] for task in tasks} == set(CATEGORIES)
    recipe = Recipe(split=split)
    held = [len(kind_seeds(recipe, task["name"])) for task in tasks]
    assert len(tasks) == len(BENCHMARK.splits[split].motions)
    assert config.episodes_per_task == min(held), "more would wrap around"


def test_the_image_copies_and_installs_what_is_here():
    lines = [
        line
        for line in (FOLDER / "Dockerfile").read_text().splitlines()
        if line and not line.startswith("#")
    ]
    instructions = [(keyword, rest) for keyword, _, rest in (line.partition(" ") for line in lines)]
    for keyword, rest in instructions:
        if keyword == "COPY":
            *sources, _ = rest.split()
            assert all(list(ROOT.glob(source.rstrip("/"))) for source in sources), rest
        elif keyword == "RUN":
            check_installation(shlex.split(rest))
    said = {
        keyword: json.loads(rest)
        for keyword, rest in instructions
        if keyword in ("ENTRYPOINT", "CMD")
    }
    assert (said["ENTRYPOINT"][0], said["CMD"][0]) == ("vla-eval", "run")
    assert (FOLDER / Path(said["CMD"][-1]).name).is_file()
