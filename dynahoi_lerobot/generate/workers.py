"""Shards on several processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.sharedctypes import Synchronized

from dynahoi_lerobot.generate.parent_watch import exit_with_parent
from dynahoi_lerobot.generate.plan import GenerationError, Progress
from dynahoi_lerobot.generate.shard import ShardMaker

STARTS = 3
"""How often a pool is started before processes that die are an error."""

POLL_S = 0.2


def make_in_processes(maker: ShardMaker, workers: int, progress: Progress) -> None:
    """Make all missing shards; when a process dies, the shards it was making are made again.

    Raises:
        GenerationError: if processes keep dying.
    """
    for _ in range(STARTS):
        try:
            return _run_pool(maker, workers, progress)
        except BrokenProcessPool:
            missing = len(maker.missing())
    raise GenerationError(
        f"worker processes died {STARTS} times with {missing} shards to go; fewer workers need less memory"
    )


def _run_pool(maker: ShardMaker, workers: int, progress: Progress) -> None:
    # Forked copies of a process that holds threads or a GPU hang; new ones do not.
    context = multiprocessing.get_context("spawn")
    shards = maker.missing()
    counter = context.Value("q", maker.done_episodes())
    count = max(1, min(workers, len(shards)))
    with ProcessPoolExecutor(count, context, initializer=_enter, initargs=(counter, os.getpid())) as pool:
        futures = [pool.submit(_make, maker, shard) for shard in shards]
        try:
            _watch(futures, counter, progress)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _watch(futures: list[Future[None]], counter: Synchronized[int], progress: Progress) -> None:
    """Report progress until all are done; raise what the first failure raised."""
    pending = set(futures)
    while pending:
        done, pending = wait(pending, POLL_S, FIRST_EXCEPTION)
        progress(counter.value)
        for future in done:
            future.result()


_counter: Synchronized[int] | None = None


def _enter(counter: Synchronized[int], parent: int) -> None:
    """Prepare a worker: keep the shared counter, and end with the parent."""
    global _counter  # noqa: PLW0603 - a process pool offers its workers no other memory
    _counter = counter
    exit_with_parent(parent)


def _make(maker: ShardMaker, shard: int) -> None:
    maker.make(shard, _count)


def _count() -> None:
    if _counter is not None:
        with _counter.get_lock():
            _counter.value += 1
