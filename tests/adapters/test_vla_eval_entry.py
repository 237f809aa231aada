"""The entry for vla-eval: the harness reads its configs, and its pages say what the benchmark does."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml
from vla_eval.benchmarks.base import Benchmark
from vla_eval.cli.config_loader import load_config
from vla_eval.cli.smoke import SmokeTest, run_validate, smoke_test_from_path
from vla_eval.config import DockerConfig, EvalConfig
from vla_eval.registry import resolve_import_string

from dynahoi_lerobot.core.rules import DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.motions import CATEGORIES
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seeds

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
    recipe = Recipe(split=split)
    held = [len(kind_seeds(recipe, task["name"])) for task in tasks]
    assert len(tasks) == len(BENCHMARK.splits[split].motions)
    assert config.episodes_per_task == min(held), "more would wrap around"


def test_the_page_lists_the_configs_as_they_are():
    page = (FOLDER / "README.md").read_text()
    _, head, body = page.split("---\n", 2)
    assert (FOLDER / yaml.safe_load(head)["smoke_config"]).is_file()
    rows = re.findall(r"^\| `(\S+\.yaml)` \| .* \| (\d+) \| (\d+) \|$", body, re.MULTILINE)
    configs = sorted(FOLDER.glob("*.yaml"))
    found = [(p.name, str(len(benchmark_of(p).get_tasks())), str(entry(p).episodes_per_task)) for p in configs]
    assert rows == found
    spec = benchmark_of(configs[0])
    assert f"shape ({spec.get_metadata()['action_dim']},)" in body
    assert f"up to {spec.get_metadata()['max_steps']}:" in body


def test_the_protocol_names_this_benchmark():
    _, head, body = (FOLDER / "protocol.md").read_text().split("---\n", 2)
    assert yaml.safe_load(head) == {"benchmark": "dynahoi"}
    assert f"benchmark {BENCHMARK.version}" in body
    assert f"control class `{DEFAULT_CONTROL_CLASS}`" in body
    assert f"{BENCHMARK.splits['test'].size:,} episodes" in body
    assert body.index("## Protocol") < body.index("## Risky Patterns")
    (registered,) = json.loads((FOLDER / "benchmarks.json").read_text()).values()
    assert registered["suites"] == list(CATEGORIES)


def test_the_image_is_built_from_what_is_there():
    lines = (FOLDER / "Dockerfile").read_text().splitlines()
    copied = [word for line in lines if line.startswith("COPY ") for word in line.split()[1:-1]]
    assert copied
    assert all(list(ROOT.glob(word.rstrip("/"))) for word in copied)
    assert 'pip install --no-cache-dir ".[vla-eval]"' in "\n".join(lines)
