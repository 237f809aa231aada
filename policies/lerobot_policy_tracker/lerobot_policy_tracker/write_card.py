"""Write the model card of a checkpoint, with the figures of its evaluations.

    python -m lerobot_policy_tracker.write_card CHECKPOINT RESULTS...

RESULTS are folders that `dynahoi evaluate` wrote; every figure is read from their ``metrics.json``. The card is written
to CHECKPOINT/README.md.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig
from safetensors import safe_open

from .configuration_tracker import TrackerConfig
from .model_card import describe

DEFAULT_RULES = {"capture": "attach", "control_class": "standard", "protocol": "observe_before_act"}
"""What `dynahoi evaluate` and the env do unless told otherwise."""

HEADER = """---
library_name: lerobot
license: {license}
pipeline_tag: robotics
tags: [lerobot, robotics, tracker, dynahoi]
{datasets}---

# {name}
"""


def card_with_results(checkpoint: Path, results: list[Path]) -> str:
    """Return the model card of a checkpoint as Markdown.

    Args:
        checkpoint: folder with ``config.json`` and ``model.safetensors``.
        results: folders with a ``metrics.json`` each.

    Raises:
        ValueError: if a folder is no tracker checkpoint or holds no results, naming it and what is missing.
    """
    config = _config(checkpoint)
    dataset = _dataset(checkpoint)
    datasets = f"datasets: [{dataset}]\n" if "/" in dataset else ""  # a name of the Hub, not "on-policy"
    name = (config.repo_id or checkpoint.resolve().name).rsplit("/", 1)[-1]
    header = HEADER.format(license=config.license or "apache-2.0", datasets=datasets, name=name)
    policy = config.repo_id or checkpoint.as_posix()
    heads = [_metrics(folder) for folder in results]
    section = describe(config, _parameters(checkpoint), dataset, policy, changed_rules(heads[0]) if heads else {})
    return header + section + "".join(results_section(head) for head in heads)


def changed_rules(head: dict[str, Any]) -> dict[str, str]:
    """Return the rules of an evaluation that are not the benchmark's defaults, by fields of the env."""
    recipe = head.get("extra", {}).get("recipe", {})
    return {name: recipe[name] for name, usual in DEFAULT_RULES.items() if recipe.get(name, usual) != usual}


def results_section(head: dict[str, Any]) -> str:
    """Return the table of one evaluation, given the content of its ``metrics.json``; fractions are in percent."""
    extra = head.get("extra", {})
    control, inference = extra.get("recipe", {}).get("control_class"), extra.get("inference")
    rules = f"capture rule `{head['capture']}`" + (f", control class `{control}`" if control else "")
    rules += f", inference {inference}" if inference else ""
    title = f"\n## Results on `{head['split']}`, {head['n']} episodes, {rules}\n"
    lines = [title, "| Metric | Value | 95 % interval | Unit | Episodes |", "| --- | --- | --- | --- | --- |"]
    lines += [_row(name, metric, head["n"]) for name, metric in head["metrics"].items() if metric["value"] is not None]
    return "\n".join(lines) + f"\n\nMeasured by `{head['command']}`, fingerprint `{head['fingerprint']}`.\n"


def main(args: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="folder of a trained tracker policy")
    parser.add_argument("results", type=Path, nargs="+", help="folders written by `dynahoi evaluate`")
    options = parser.parse_args(args)
    try:
        card = card_with_results(options.checkpoint, options.results)
        (options.checkpoint / "README.md").write_text(card, encoding="utf-8")
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _row(name: str, metric: dict[str, Any], n_episodes: int) -> str:
    scale, unit = (100, "%") if metric["unit"] == "fraction" else (1, metric["unit"])
    value, low, high = (scale * metric[key] for key in ("value", "low", "high"))
    return f"| {name} | {value:.2f} | [{low:.2f}, {high:.2f}] | {unit} | {metric.get('n', n_episodes)} |"


def _config(checkpoint: Path) -> TrackerConfig:
    for file in ("config.json", "model.safetensors"):
        if not (checkpoint / file).is_file():
            raise ValueError(f"{checkpoint} is no checkpoint: {file} is missing; name a pretrained_model folder.")
    config = PreTrainedConfig.from_pretrained(checkpoint)
    if not isinstance(config, TrackerConfig):
        raise ValueError(f"{checkpoint} holds a policy of type {config.type!r}, but must be of type 'tracker'.")
    return config


def _parameters(checkpoint: Path) -> int:
    """Return the number of parameters of the network, without the averaged copy."""
    with safe_open(checkpoint / "model.safetensors", framework="np") as tensors:
        shapes = [tensors.get_slice(key).get_shape() for key in tensors.keys() if key.startswith("model.")]  # noqa: SIM118
    return sum(math.prod(shape) for shape in shapes)


def _dataset(checkpoint: Path) -> str:
    """Return the training data's name as training recorded it, "on-policy" of none that is kept; "" if unknown."""
    file = checkpoint / "train_config.json"
    return json.loads(file.read_text(encoding="utf-8"))["dataset"]["repo_id"] if file.is_file() else ""


def _metrics(folder: Path) -> dict[str, Any]:
    file = folder / "metrics.json"
    if not file.is_file():
        raise ValueError(f"{folder} holds no results: metrics.json is missing; run `dynahoi evaluate --out {folder}`.")
    try:
        head = json.loads(file.read_text(encoding="utf-8"))
        results_section(head)
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{file} is damaged ({type(error).__name__}: {error}); run `dynahoi evaluate` again."
        ) from None
    return head


if __name__ == "__main__":
    sys.exit(main())
