"""The promise: an episode is the same bytes whatever the batch, the threads, the neighbours and the process."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.core.spec import EpisodeSpec
from tests.world.playing import digests, wait, world

SHORTEST = 6


@pytest.fixture(scope="module")
def every_kind(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    return specs[:22]


@pytest.fixture(scope="module")
def reference(every_kind: list[EpisodeSpec]) -> dict[int, str]:
    """Without images: eight worlds, one thread, in order."""
    return digests(every_kind, 8)


@pytest.fixture(scope="module")
def short(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    """Of every category, the episodes that are over soonest."""
    chosen: dict[str, EpisodeSpec] = {}
    for spec in sorted(specs, key=lambda s: s.intercept_frame):
        chosen.setdefault(spec.motion.category, spec)
    return list(chosen.values())[:SHORTEST]


@pytest.fixture(scope="module")
def pictures(short: list[EpisodeSpec]) -> dict[int, str]:
    return digests(short, 1, images=True)


@pytest.mark.parametrize(("size", "threads"), [(1, 1), (3, 2), (8, 2)])
def test_states_depend_on_no_batch_size_and_no_thread_count(
    every_kind: list[EpisodeSpec], reference: dict[int, str], size: int, threads: int
):
    assert digests(every_kind, size, threads) == reference


def test_states_depend_on_no_neighbour_and_no_row(every_kind: list[EpisodeSpec], reference: dict[int, str]):
    assert digests(every_kind[::-1], 5) == reference
    companions = digests([every_kind[i] for i in (3, 21, 8, 0)], 4)
    assert companions == {seed: reference[seed] for seed in companions}


@pytest.mark.parametrize(("size", "threads"), [(3, 1), (8, 2)])
def test_pixels_depend_on_no_batch_size_and_no_neighbour(
    short: list[EpisodeSpec], pictures: dict[int, str], size: int, threads: int
):
    assert len(set(pictures.values())) == len(short)
    assert digests(short[::-1], size, threads, images=True) == pictures


def test_another_process_sees_the_same_bytes(short: list[EpisodeSpec], pictures: dict[int, str]):
    seeds = [spec.seed for spec in short[:2]]
    command = [sys.executable, "-m", "tests.world.playing", *map(str, seeds)]
    root = Path(__file__).parents[2]
    told = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    assert ast.literal_eval(told.splitlines()[-1]) == {seed: pictures[seed] for seed in seeds}


def test_resetting_one_world_leaves_the_others_untouched(every_kind: list[EpisodeSpec]):
    batch = world(every_kind[:6])
    wait(batch)
    before, images = batch._batch.state.copy(), batch.cameras.render()
    batch.reset([2], [every_kind[9]])
    others = [0, 1, 3, 4, 5]
    np.testing.assert_array_equal(batch._batch.state[others], before[others])
    np.testing.assert_array_equal(batch.cameras.render()[others], images[others])
    undisturbed = world(every_kind[:6])
    wait(undisturbed)
    for _ in range(5):
        batch.step(batch.executed[others], np.array(others))
        undisturbed.step(undisturbed.executed)
    np.testing.assert_array_equal(batch._batch.state[others], undisturbed._batch.state[others])


def test_a_world_remembers_nothing_of_its_last_episode(every_kind: list[EpisodeSpec], reference: dict[int, str]):
    """One world plays struck, pendulum, ramp and wall in turn; fixtures, welds and masses must not linger."""
    order = [s for s in every_kind if s.motion.category in ("impact_response", "pendulum", "inclined_rolling")]
    once = digests([*order, *order[::-1]], 1)
    assert once == {seed: reference[seed] for seed in once}
