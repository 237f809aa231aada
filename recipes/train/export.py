"""Export a checkpoint for acting alone, with a model card that holds its results.

python recipes/train/export.py outputs/obact_cpu/checkpoints/last/pretrained_model results/obact_cpu OUT
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_pre_post_processors
from lerobot_policy_obact import ObActPolicy
from lerobot_policy_obact.model_card import describe

from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.metrics import METRICS

SHOWN = ("S_hold", "S_loc", "E_loc", "S_gra", "E_gra", "S_joint", "Q_smooth", "Q_line", "R_time")
HEADER = """---
library_name: lerobot
license: apache-2.0
pipeline_tag: robotics
tags: [lerobot, robotics, obact, dynahoi]
---

# ObAct, trained on two CPU cores

`dynahoi view --policy {out} --capture {capture} --motion planar --out catch.gif` plays it.
"""


def main() -> None:
    """Write the folder that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    config = PreTrainedConfig.from_pretrained(args.checkpoint)
    config.ema_decay = 0.0  # the average becomes the weights: half the size
    config.pretrained_path = None
    policy = ObActPolicy.from_pretrained(args.checkpoint, config=config)
    policy.save_pretrained(args.out)
    for pipeline in make_pre_post_processors(config, pretrained_path=str(args.checkpoint)):
        pipeline.save_pretrained(args.out)
    description = describe(config, n_parameters=sum(p.numel() for p in policy.model.parameters()))
    header = HEADER.format(out=args.out, capture=read_results(args.results).info.capture)
    (args.out / "README.md").write_text(header + description + results_section(args.results))


def results_section(folder: Path) -> str:
    """Return the results as Markdown."""
    results = read_results(folder)
    title = f"\n## Results on `{results.info.split}`, {len(results.rows)} episodes\n"
    lines = [title, "| metric | value | 95 % interval |", "|---|---|---|"]
    for name in SHOWN:
        estimate = results.summary()[name].as_json()
        if estimate["value"] is None:
            continue
        scale = 100 if METRICS[name].unit == "fraction" else 1
        low, high = (scale * value for value in (estimate["low"], estimate["high"]))
        lines.append(f"| {name} | {scale * estimate['value']:.2f} | [{low:.2f}, {high:.2f}] |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
