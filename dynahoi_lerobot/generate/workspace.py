"""The workspace ``<root>.partial``: where shards are made, by one process at a time, and what may be removed of it."""

from __future__ import annotations

import logging
import shutil
from contextlib import AbstractContextManager
from pathlib import Path

from dynahoi_lerobot.core.working_folder import LOCK, read_task, working_folder
from dynahoi_lerobot.dataset.files import remove_stale
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.generate.shard import SHARD

PLAN, LOGS = "plan.json", "logs"

logger = logging.getLogger(__name__)


def workspace_path(root: Path) -> Path:
    """Return where a dataset's shards are made."""
    return root.with_name(f"{root.name}.partial")


def open_workspace(plan: GenerationPlan, root: Path) -> AbstractContextManager[Path]:
    """Return the context of a workspace, new or of an interrupted run of the same plan, see ``working_folder``."""
    return working_folder(workspace_path(root), plan.identity(), PLAN)


def remove_workspace(plan: GenerationPlan, root: Path) -> None:
    """Remove what generation made in the plan's workspace, and the workspace if nothing else is in it."""
    workspace = workspace_path(root)
    if not workspace.is_dir() or read_task(workspace, PLAN) != plan.identity():
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
