"""A plan of a billion episodes begins at once: its shards are numbered one by one, and no list of them is made."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator

import pytest

from dynahoi_lerobot.generate.executors import EXECUTORS, ClusterResources
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan
from dynahoi_lerobot.generate.shard import ShardMaker
from tests.generate import recorder
from tests.generate.recorder import FakeRecipe
from tests.generate.test_command import run

BILLION = 10**9


@pytest.fixture
def plan() -> GenerationPlan:
    return GenerationPlan(FakeRecipe(), BILLION)


@pytest.fixture(autouse=True)
def within_five_seconds_and_sixty_megabytes() -> Iterator[None]:
    tracemalloc.start()
    begin = time.monotonic()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert time.monotonic() - begin < 5
    assert peak < 60e6


def test_the_first_shard_is_known_at_once(plan, tmp_path):
    maker = ShardMaker(plan, tmp_path, recorder.record)
    shards = maker.missing()
    assert [next(shards), next(shards)] == [0, 1]
    assert maker.plan.slots(0) == range(256)
    assert maker.plan.slots(plan.shards - 1) == range(BILLION - 256, BILLION)
    assert maker.done_episodes() == 0


def test_what_is_there_is_counted_and_left_out(plan, tmp_path):
    small = GenerationPlan(FakeRecipe(), BILLION, shard_episodes=2)
    maker = ShardMaker(small, tmp_path, recorder.record)
    maker.make(1)
    (tmp_path / "shard-999999999999").mkdir()  # beyond the plan
    (tmp_path / "shard-x").mkdir()
    assert maker.present() == [1]
    assert (maker.done_episodes(), next(maker.missing())) == (2, 0)
    maker.make(0)
    assert next(maker.missing()) == 2


def test_the_first_episodes_are_asked_for_at_once(tmp_path, capsys):
    asked = []

    def stopped(recipe, seeds):
        asked.append(list(seeds))
        raise KeyboardInterrupt

    assert run("--root", tmp_path / "d", "--episodes", BILLION, record=stopped) == 130
    assert asked == [list(range(256))]


def test_a_cluster_gets_a_thousand_tasks_and_a_description_at_once(plan, tmp_path):
    executor = EXECUTORS["local"](plan, tmp_path / "d", recorder.record, ClusterResources())
    assert executor.tasks == 1000
    assert "3906250 shards" in executor.describe()
    executor._forget_lost_work()


@pytest.fixture
def few_shards_ahead(monkeypatch) -> list[int]:
    """Shards that the pool was given, without any process."""
    from dynahoi_lerobot.generate import workers

    submitted: list[int] = []

    class Pool(workers.ProcessPoolExecutor):
        def submit(self, task, maker, shard):
            submitted.append(shard)
            future = workers.Future()
            future.set_exception(GenerationError("stopped")) if shard == 0 else None
            return future

    monkeypatch.setattr(workers, "ProcessPoolExecutor", Pool)
    return submitted


def test_processes_get_few_shards_ahead(plan, tmp_path, few_shards_ahead):
    with pytest.raises(GenerationError, match="stopped"):
        generate(plan, tmp_path / "d", record=recorder.record, workers=4)
    assert few_shards_ahead == list(range(8))
