"""The entry for vla-eval: the harness reads its configs, and no episode is played twice."""

from __future__ import annotations

from pathlib import Path

import pytest
from vla_eval.benchmarks.base import Benchmark
from vla_eval.cli.config_loader import load_config
from vla_eval.cli.smoke import SmokeTest, run_validate, smoke_test_from_path
from vla_eval.config import DockerConfig, EvalConfig
from vla_eval.registry import resolve_import_string

from dynahoi_lerobot.motions import CATEGORIES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seeds, seed_stream

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "envs" / "vla_eval"
CONFIGS = pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.name)


def entry(path: Path) -> EvalConfig:
    (only,) = load_config(str(path))["benchmarks"]
    return EvalConfig.from_dict(only)


def benchmark_of(path: Path) -> Benchmark:
    config = entry(path)
    return resolve_import_string(config.benchmark)(**config.params)


@CONFIGS
def test_the_harness_takes_the_config(path: Path):
    test = smoke_test_from_path(path)
    assert isinstance(test, SmokeTest)
    assert test.category == "benchmark"
    assert (run_validate([test]).status, run_validate([test]).message) == ("pass", "1/1 configs valid")
    docker = DockerConfig.from_dict(load_config(str(path))["docker"])
    assert docker.build is not None
    assert Path(docker.build.dockerfile_path).resolve() == FOLDER / "Dockerfile"


@CONFIGS
def test_every_episode_is_another_one(path: Path):
    config, benchmark = entry(path), benchmark_of(path)
    tasks, split = benchmark.get_tasks(), config.params["split"]
    assert {task["suite"] for task in tasks} == set(CATEGORIES)
    recipe = Recipe(split=seed_stream(split))
    held = [len(kind_seeds(recipe, split, task["name"])) for task in tasks]
    assert len(tasks) == len(BENCHMARK.splits[split].motions)
    assert config.episodes_per_task == min(held), "more would wrap around"
