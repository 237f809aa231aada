"""The workspace ``<root>.partial``: where shards are made, by one process at a time, and what may be removed of it."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dynahoi_lerobot.dataset.files import remove_stale, replace_text
from dynahoi_lerobot.generate.lock import exclusive
from dynahoi_lerobot.generate.plan import GenerationPlan

PLAN, LOCK, LOGS, SHARD = "plan.json", "lock", "logs", "shard-"

logger = logging.getLogger(__name__)


def workspace_path(root: Path) -> Path:
    """Return where a dataset's shards are made."""
    return root.with_name(f"{root.name}.partial")


@contextmanager
def open_workspace(plan: GenerationPlan, root: Path) -> Iterator[Path]:
    """Make the workspace, or enter that of an interrupted run of the same plan, and hold its lock.

    Raises:
        FileExistsError: if it belongs to another plan, or generation did not make it.
        GenerationError: if another process works in it.
    """
    workspace = workspace_path(root)
    if workspace.exists() and not workspace.is_dir():
        raise FileExistsError(f"{workspace} is a file; remove it or choose another folder")
    workspace.mkdir(parents=True, exist_ok=True)
    _refuse_foreign(workspace)
    with exclusive(workspace / LOCK):
        _claim(workspace, plan.identity())
        yield workspace


def remove_workspace(plan: GenerationPlan, root: Path) -> None:
    """Remove what generation made in the plan's workspace, and the workspace if nothing else is in it."""
    workspace = workspace_path(root)
    if not workspace.is_dir() or _read_plan(workspace) != plan.identity():
        return
    for path in [*workspace.glob(f"{SHARD}*"), workspace / LOGS]:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
    for name in (PLAN, f"{SHARD}*"):
        remove_stale(workspace, name)
    (workspace / LOCK).unlink(missing_ok=True)
    (workspace / PLAN).unlink(missing_ok=True)
    try:
        workspace.rmdir()
    except OSError:
        names = ", ".join(sorted(path.name for path in workspace.iterdir()))
        logger.warning("%s stays, because generation did not make all that is in it: %s", workspace, names)


def differences(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    """Name what differs between two plans' identities, looking into their recipes; empty if nothing does."""
    names = [key for key in wanted if key != "recipe" and found.get(key) != wanted[key]]
    recipe = found.get("recipe") or {}
    names += [key for key, value in wanted["recipe"].items() if recipe.get(key) != value]
    return ", ".join(names)


def _refuse_foreign(workspace: Path) -> None:
    """Refuse a folder with content but without a plan; an interrupted start may have left its lock."""
    if (workspace / PLAN).exists():
        return
    ours = (LOCK, f".{PLAN}.")
    if foreign := sorted(path.name for path in workspace.iterdir() if not path.name.startswith(ours)):
        raise FileExistsError(
            f"{workspace} holds {foreign[0]} but no {PLAN}, so generation did not make it; remove it or choose "
            "another folder"
        )


def _claim(workspace: Path, identity: dict[str, Any]) -> None:
    """Write the plan into a new workspace; compare it with that of an old one."""
    if not (workspace / PLAN).exists():
        replace_text(workspace / PLAN, json.dumps(identity, indent=4))
        return
    found = _read_plan(workspace)
    if found is None:
        raise FileExistsError(f"{workspace / PLAN} cannot be read; remove {workspace} or choose another folder")
    if names := differences(found, identity):
        raise FileExistsError(
            f"{workspace} holds unfinished work of another dataset (other {names}); remove it or choose another folder"
        )


def _read_plan(workspace: Path) -> dict[str, Any] | None:
    """Return the identity of the plan that a workspace belongs to, None if it cannot be read."""
    try:
        content = json.loads((workspace / PLAN).read_text())
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
