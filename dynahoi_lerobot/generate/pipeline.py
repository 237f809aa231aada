"""generate: make all shards of a plan, check them and merge them. Stop it anywhere and start it again."""

from __future__ import annotations

import itertools
from pathlib import Path

from dynahoi_lerobot.core.files import check_output
from dynahoi_lerobot.core.working_folder import differences
from dynahoi_lerobot.dataset.manifest import Manifest, file_problems
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan, Progress, Record
from dynahoi_lerobot.generate.shard import ShardMaker
from dynahoi_lerobot.generate.workers import make_in_processes
from dynahoi_lerobot.generate.workspace import open_workspace, remove_workspace

MAX_WORKERS = 4096
CHECKS = 3
"""How often shards that are found damaged are made again before the disk is called unreliable."""


def generate(
    plan: GenerationPlan, root: Path, *, record: Record, workers: int = 1, progress: Progress = lambda _: None
) -> Manifest:
    """Make the dataset of a plan.

    Shards are made in ``<root>.partial`` and merged at the end, so ``root`` exists only when it is complete. Whatever
    ended an earlier run, the shards it finished are checked and kept, and the result is the same.

    Args:
        plan: what to make.
        root: the dataset's folder; if it already holds this very dataset, its files are checked and nothing is made.
        record: plays the expert; a module's function if ``workers`` is more than 1.
        workers: processes; the result is the same for any number.
        progress: called with the number of episodes that are done.

    Raises:
        FileExistsError: if ``root`` or the unfinished work beside it belongs to something else.
        GenerationError: if the expert cannot make the episodes, processes keep dying, another process is making this
            dataset, or the files of a finished one have changed.
        ValueError: if ``workers`` is out of its range, or no folder can be made at ``root``.
    """
    if not 1 <= workers <= MAX_WORKERS:
        raise ValueError(f"the number of workers is {workers}; it must be 1 to {MAX_WORKERS}")
    check_output(root)
    if (manifest := finished(plan, root)) is None:
        with open_workspace(plan, root) as workspace:
            # Another process may have finished while this one waited for the lock.
            manifest = finished(plan, root) or _make(ShardMaker(plan, workspace, record), root, workers, progress)
    progress(manifest.episodes)
    remove_workspace(plan, root)
    return manifest


def finished(plan: GenerationPlan, root: Path) -> Manifest | None:
    """Return the manifest if ``root`` already holds the plan's dataset, None if nothing is there.

    Raises:
        FileExistsError: if something else is there.
        GenerationError: if the dataset is there but a file of it is missing or has changed.
    """
    if not root.exists():
        return None
    try:
        manifest = Manifest.read(root)
    except (OSError, ValueError):
        raise FileExistsError(f"{root} exists and is no dataset of ours; choose another folder") from None
    if names := differences(manifest.provenance, plan.identity()):
        raise FileExistsError(f"{root} holds another dataset (other {names}); choose another folder")
    if problem := next(file_problems(root, manifest), None):
        raise GenerationError(f"{root} is complete but damaged: {problem}; remove it to make it again")
    return manifest


def make_missing(maker: ShardMaker, workers: int, progress: Progress) -> None:
    """Make every shard that is not there yet."""
    if workers > 1:
        return make_in_processes(maker, workers, progress)
    done = itertools.count(maker.done_episodes() + 1)
    for shard in maker.missing():
        maker.make(shard, lambda: progress(next(done)))
    return None


def _make(maker: ShardMaker, root: Path, workers: int, progress: Progress) -> Manifest:
    for _ in range(CHECKS):
        make_missing(maker, workers, progress)
        if not maker.discard_damaged():
            return maker.merge(root)
    raise GenerationError(f"shards in {maker.folder} were damaged {CHECKS} times after they were made; check the disk")
