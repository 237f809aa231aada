"""The environment as LeRobot loads one from the Hub."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lerobot.envs.utils import _call_make_env, _import_hub_module, _normalize_hub_result

FILE = Path(__file__).parents[2] / "envs" / "hub" / "env.py"


class Other:
    task = "lob,pendulum"


def test_lerobot_loads_the_file_and_plays(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = _import_hub_module(str(FILE), "you/dynahoi")
    suites = _normalize_hub_result(_call_make_env(module, n_envs=2, use_async_envs=False, cfg=Other()))
    assert {name: len(tasks) for name, tasks in suites.items()} == {"projectile": 1, "pendulum": 3}
    env = suites["projectile"][0]
    observation, _ = env.reset(seed=[0, 1])
    assert observation["pixels"]["ego"].shape[0] == 2
    assert np.isfinite(env.step(observation["agent_pos"])[1]).all()


@pytest.mark.slow
def test_without_a_task_the_file_offers_every_motion() -> None:
    module = _import_hub_module(str(FILE), "you/dynahoi")
    everything = _normalize_hub_result(_call_make_env(module, n_envs=1, use_async_envs=False, cfg=None))
    assert sum(map(len, everything.values())) == 22
