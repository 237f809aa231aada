"""generate: make all shards of a plan and merge them. Stop it anywhere and start it again."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from dynahoi_lerobot.dataset.files import replace_text
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.generate.plan import GenerationPlan, Progress, Record
from dynahoi_lerobot.generate.shard import ShardMaker
from dynahoi_lerobot.generate.workers import make_in_processes


def generate(
    plan: GenerationPlan, root: Path, *, record: Record, workers: int = 1, progress: Progress = lambda _: None
) -> Manifest:
    """Make the dataset of a plan.

    Shards are made in ``<root>.partial`` and merged at the end, so ``root`` exists only when it is whole.
    Whatever ended an earlier run, the shards it finished are kept, and the result is the same.

    Args:
        plan: what to make.
        root: the dataset's folder; if it already holds this very dataset, nothing is done.
        record: plays the expert; a module's function if ``workers`` is more than 1.
        workers: processes; the result is the same for any number.
        progress: called with the number of episodes that are done.

    Raises:
        FileExistsError: if ``root`` or the unfinished work beside it belongs to something else.
        GenerationError: if the expert cannot make the episodes, or processes keep dying.
        ValueError: if ``workers`` is not positive.
    """
    if workers < 1:
        raise ValueError(f"the number of workers is {workers}; it must be 1 or more")
    if (manifest := finished(plan, root)) is None:
        maker = ShardMaker(plan, open_workspace(plan, root), record)
        make_missing(maker, workers, progress)
        manifest = merge_shards(maker, root)
    progress(manifest.episodes)
    shutil.rmtree(workspace_path(root), ignore_errors=True)
    return manifest


def finished(plan: GenerationPlan, root: Path) -> Manifest | None:
    """Return the manifest if ``root`` already holds the plan's dataset, None if nothing is there.

    Raises:
        FileExistsError: if something else is there.
    """
    if not root.exists():
        return None
    try:
        manifest = Manifest.read(root)
    except (OSError, ValueError, TypeError):
        raise FileExistsError(f"{root} exists and is no dataset of ours; choose another folder") from None
    if differences := _differences(manifest.provenance, plan.identity()):
        raise FileExistsError(f"{root} holds another dataset (other {differences}); choose another folder")
    return manifest


def workspace_path(root: Path) -> Path:
    """Return where a dataset's shards are made."""
    return root.with_name(f"{root.name}.partial")


def open_workspace(plan: GenerationPlan, root: Path) -> Path:
    """Make the folder for the shards, or enter that of an interrupted run of the same plan.

    Raises:
        FileExistsError: if it belongs to another plan.
    """
    workspace, identity = workspace_path(root), plan.identity()
    workspace.mkdir(parents=True, exist_ok=True)
    note = workspace / "plan.json"
    if not note.exists():
        replace_text(note, json.dumps(identity, indent=4))
    elif differences := _differences(json.loads(note.read_text()), identity):
        raise FileExistsError(
            f"{workspace} holds unfinished work of another dataset (other {differences}); remove it or choose "
            "another folder"
        )
    return workspace


def make_missing(maker: ShardMaker, workers: int, progress: Progress) -> None:
    """Make every shard that is not there yet."""
    if workers > 1:
        return make_in_processes(maker, workers, progress)
    for shard in maker.missing():
        done = maker.done_episodes()
        ticks = iter(range(done + 1, done + 1 + len(maker.plan.slots(shard))))
        maker.make(shard, lambda ticks=ticks: progress(next(ticks)))
    return None


def merge_shards(maker: ShardMaker, root: Path) -> Manifest:
    """Merge the finished shards of a plan into ``root``."""
    sources = [maker.path(shard) for shard in range(maker.plan.shards)]
    return merge(sources, root, limits=maker.plan.limits, provenance=maker.plan.identity())


def _differences(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    """Name what differs between two plans, looking into their recipes; empty if nothing does."""
    names = [key for key in wanted if key != "recipe" and found.get(key) != wanted[key]]
    recipe = found.get("recipe") or {}
    names += [key for key, value in wanted["recipe"].items() if recipe.get(key) != value]
    return ", ".join(names)
