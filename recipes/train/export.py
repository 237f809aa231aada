"""Export a checkpoint for acting alone, with a model card that holds its results.

python recipes/train/export.py outputs/tracker_cpu/checkpoints/last/pretrained_model results/tracker_cpu OUT
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_pre_post_processors
from lerobot_policy_tracker import TrackerPolicy
from lerobot_policy_tracker.write_card import card_with_results


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
    policy = TrackerPolicy.from_pretrained(args.checkpoint, config=config)
    policy.save_pretrained(args.out)
    for pipeline in make_pre_post_processors(config, pretrained_path=str(args.checkpoint)):
        pipeline.save_pretrained(args.out)
    (args.out / "README.md").write_text(card_with_results(args.out, [args.results]))


if __name__ == "__main__":
    main()
