"""generate: make all shards of a plan, check them and merge them. Stop it anywhere and start it
again.

Shards are made in the workspace ``<root>.partial`` by one run at a time, on one process or several.
"""

from __future__ import annotations

import itertools
import logging
import multiprocessing
import os
import shutil
import threading
import time
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, closing, suppress
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.core.reading import ReadError
from dynahoi_lerobot.core.working_folder import (
    LOCK,
    TASK,
    differences,
    read_task,
    working_folder,
    workspace_path,
)
from dynahoi_lerobot.dataset.manifest import Manifest, file_problems
from dynahoi_lerobot.generate.plan import SHARD, GenerationPlan, Progress, Record, ShardMaker

logger = logging.getLogger(__name__)

LOGS = "logs"
STARTS = 3
"""How often a pool is started before processes that die are an error."""
POLL_S = 0.2


def generate(
    plan: GenerationPlan,
    root: Path,
    *,
    record: Record,
    workers: int = 1,
    progress: Progress = lambda _: None,
) -> Manifest:
    """Make the dataset of a plan.

    ``root`` exists only when it is complete. Whatever ended an earlier run, the shards it finished
    are checked and kept, and the result is the same.

    Args:
        plan: what to make.
        root: the dataset's folder; if it already holds this very dataset, its files are checked and
            nothing is made.
        record: plays the expert; a module's function if ``workers`` is more than 1.
        workers: processes; the result is the same for any number.
        progress: called with the number of episodes that are done.

    Raises:
        BlockingIOError: if another process is making this dataset.
        FileExistsError: if ``root`` or the unfinished work beside it belongs to something else.
        CommandError: if the expert cannot make the episodes, processes keep dying, or the files of
            a finished dataset have changed.
        ValueError: if no folder can be made at ``root``.
    """
    check_output(root)
    manifest = finished(plan, root)
    if manifest is None:
        with open_workspace(plan, root) as workspace:
            maker = ShardMaker(plan, workspace, record)
            maker.discard_damaged()
            with closing(made(maker, workers, progress)) as shards:
                manifest = maker.merge(root, shards)
    progress(manifest.episodes)
    remove_workspace(plan, root)
    return manifest


def finished(plan: GenerationPlan, root: Path) -> Manifest | None:
    """Return the manifest if ``root`` already holds the plan's dataset, None if nothing is there.

    Raises:
        FileExistsError: if something else is there.
        CommandError: if the dataset is there but a file of it is missing or has changed.
    """
    if not root.exists():
        return None
    try:
        manifest = Manifest.read(root)
    except ReadError:
        raise FileExistsError(
            f"{root} exists and is no dataset of ours; choose another folder"
        ) from None
    names = differences(manifest.provenance, plan.identity())
    if names:
        raise FileExistsError(
            f"{root} holds another dataset (other {names}); choose another folder"
        )
    problem = next(file_problems(root, manifest), None)
    if problem:
        raise CommandError(f"{root} is complete but damaged: {problem}; remove it to make it again")
    return manifest


def made(maker: ShardMaker, workers: int, progress: Progress) -> Generator[int]:
    """Make every shard that is not there yet, and yield all in the order of the plan, each as soon
    as it is there; when a process dies, the shards it was making are made again.

    Raises:
        CommandError: if processes keep dying.
    """
    following = 0
    if workers == 1:
        missing = maker.missing()
        done = itertools.count(_done_episodes(maker.plan, missing) + 1)
        for shard in range(maker.plan.shards):
            maker.make(shard, lambda: progress(next(done)))
            yield shard
        return
    for _ in range(STARTS):
        with suppress(BrokenProcessPool):
            for shard in _run_pool(maker, workers, progress, following):
                following = shard + 1
                yield shard
            return
    raise CommandError(
        f"worker processes died {STARTS} times with {len(maker.missing())} shards to go; fewer "
        f"workers need less memory"
    )


def _done_episodes(plan: GenerationPlan, missing: list[int]) -> int:
    return plan.episodes - sum(len(plan.slots(shard)) for shard in missing)


def _run_pool(maker: ShardMaker, workers: int, progress: Progress, following: int) -> Iterator[int]:
    """Make the missing shards in processes; yield those from number ``following`` on."""
    # Forked copies of a process that holds threads or a GPU hang; new ones do not.
    context = multiprocessing.get_context("spawn")
    missing = maker.missing()
    counter = context.Value("q", _done_episodes(maker.plan, missing))
    count = max(1, min(workers, len(missing)))
    with ProcessPoolExecutor(
        count, context, initializer=_enter, initargs=(counter, os.getpid())
    ) as pool:
        pending = {pool.submit(maker.make, shard, _count) for shard in missing}
        try:
            for shard in range(following, maker.plan.shards):
                while pending and not maker.path(shard).is_dir():
                    done, pending = wait(pending, POLL_S, FIRST_COMPLETED)
                    progress(counter.value)
                    for future in done:
                        future.result()
                yield shard
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_counter: Synchronized[int] | None = None


def _enter(counter: Synchronized[int], parent: int) -> None:
    """Prepare a worker: keep the shared counter, and end with the parent."""
    global _counter  # noqa: PLW0603 - a process pool offers its workers no other memory
    _counter = counter
    exit_with_parent(parent)


def _count() -> None:
    if _counter is not None:
        with _counter.get_lock():
            _counter.value += 1


def exit_with_parent(parent: int) -> None:
    """End this process soon after its ``parent``, a process id, has ended, however that happens;
    now, if it has.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def open_workspace(plan: GenerationPlan, root: Path) -> AbstractContextManager[Path]:
    """Return the context of a workspace, new or of an interrupted run of the same plan, see
    ``working_folder``.
    """
    return working_folder(workspace_path(root), plan.identity())


def remove_workspace(plan: GenerationPlan, root: Path) -> None:
    """Remove what generation made in the plan's workspace, and the workspace if nothing else is in
    it.
    """
    workspace = workspace_path(root)
    if not workspace.is_dir() or read_task(workspace) != plan.identity():
        return
    for path in [*workspace.glob(f"{SHARD}*"), *workspace.glob(".*.tmp"), workspace / LOGS]:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
    for name in (LOCK, TASK):
        (workspace / name).unlink(missing_ok=True)
    try:
        workspace.rmdir()
    except OSError:
        names = ", ".join(sorted(path.name for path in workspace.iterdir()))
        logger.warning(
            "%s stays, because generation did not make all that is in it: %s", workspace, names
        )
