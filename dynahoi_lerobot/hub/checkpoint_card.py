"""The model card of a checkpoint that has none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

BODY = """
# {name}

A `{type}` policy of [LeRobot](https://github.com/huggingface/lerobot) for catching moving objects with a
dexterous hand.

```bash
pip install "dynahoi_lerobot[lerobot]"
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
    metadata = {
        "library_name": "lerobot",
        "license": config.get("license") or "apache-2.0",
        "pipeline_tag": "robotics",
        "tags": ["lerobot", "robotics", "dynahoi", config["type"]],
    } | ({"datasets": [dataset]} if isinstance(dataset, str) else {})
    head = yaml.safe_dump(metadata, sort_keys=False)
    return f"---\n{head}---\n" + BODY.format(name=repo.rpartition("/")[2], type=config["type"], repo=repo)


def _object(path: Path) -> dict[str, Any]:
    """Return a JSON object, an empty one if there is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
