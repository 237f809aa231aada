"""Weights of a policy: what tells one checkpoint from another of the same type."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from dynahoi_lerobot.evaluate.checkpoint import folder_weights
from dynahoi_lerobot.evaluate.results import WEIGHTS, RunInfo

if TYPE_CHECKING:
    from huggingface_hub import HfApi

LEROBOT_EVAL = re.compile(r"lerobot[-_]eval(?:\.py)? (?:.* )?--policy\.(?:pretrained_)?path[= ](\S+)")


def repository_weights(api: HfApi, repo: str) -> dict[str, str]:
    """Return the sha256 of every large file in a model's repository, by path."""
    from huggingface_hub.hf_api import RepoFile

    tree = api.list_repo_tree(repo, recursive=True, repo_type="model")
    return {entry.path: entry.lfs.sha256 for entry in tree if isinstance(entry, RepoFile) and entry.lfs}


def other_weights(weights: Mapping[str, str], held: Mapping[str, str], *, complete: bool) -> list[str]:
    """Return the names of ``weights`` that ``held`` has with another content or, if it must be complete, lacks."""
    return [name for name, digest in weights.items() if held.get(name, "" if complete else digest) != digest]


def evaluated(info: RunInfo) -> str:
    """Return the path or repository of the policy that results are of; its name if they say no more.

    LeRobot's environment knows a local checkpoint by its type, and only the command says where it lay.
    """
    found = LEROBOT_EVAL.match(info.command)
    return found[1] if found else info.policy


def evaluated_weights(info: RunInfo) -> dict[str, str]:
    """Return the sha256 of the weights that results are of, by name; of those there now if they do not say it."""
    stored = info.extra.get(WEIGHTS)
    if isinstance(stored, dict) and all(isinstance(digest, str) for digest in stored.values()):
        return stored
    return folder_weights(Path(evaluated(info)))
