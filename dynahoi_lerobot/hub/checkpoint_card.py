"""The model card of a checkpoint without one."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

import yaml

PLUGINS = {"tracker": "lerobot_policy_tracker", "actiontokens": "lerobot_policy_actiontokens"}
"""Distribution that provides a policy type."""
EXTRAS = {"pi0": "pi", "pi0_fast": "pi", "pi05": "pi", "multi_task_dit": "multi-task-dit", "vla_jepa": "vla-jepa"}
"""Extra of LeRobot that a policy type needs, where the names differ."""
BODY = """
# {name}

A `{type}` policy of [LeRobot](https://github.com/huggingface/lerobot) for catching moving objects with a
dexterous hand.

```bash
pip install {needed}   # in a checkout of dynahoi-lerobot
dynahoi evaluate --policy {repo} --split test --out results/{name}
```
"""


def checkpoint_card(folder: Path, repo: str) -> str:
    """Return the card of a ``pretrained_model`` folder with the metadata that the Hub reads.

    Raises:
        ValueError: if its config is no JSON object with a policy type.
    """
    config, training = _object(folder / "config.json"), _object(folder / "train_config.json")
    if not isinstance(config.get("type"), str):
        raise ValueError(f"{folder / 'config.json'} names no policy type; name a pretrained_model folder")
    dataset = (training.get("dataset") or {}).get("repo_id")
    head = {
        "library_name": "lerobot",
        "license": config.get("license") or "apache-2.0",
        "pipeline_tag": "robotics",
        "tags": ["lerobot", "robotics", "dynahoi", config["type"]],
    } | ({"datasets": [dataset]} if isinstance(dataset, str) and "/" in dataset else {})
    return f"---\n{yaml.safe_dump(head, sort_keys=False)}---\n" + BODY.format(
        name=repo.rpartition("/")[2], type=config["type"], repo=repo, needed=_needed(config["type"])
    )


def _needed(policy: str) -> str:
    """Return the arguments of ``pip install``, in a checkout, that a policy type needs."""
    words = ['".[lerobot]"', "./envs/lerobot_env_dynahoi"]
    extra = EXTRAS.get(policy, policy)
    if policy in PLUGINS:
        words.append(f"./policies/{PLUGINS[policy]}")
    elif extra in _extras():
        words.append(f'"lerobot[{extra}]"')
    return " ".join(words)


def _extras() -> list[str]:
    try:
        return metadata("lerobot").get_all("Provides-Extra") or []
    except PackageNotFoundError:
        return []


def _object(path: Path) -> dict[str, Any]:
    """Return a JSON object, an empty one if there is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
