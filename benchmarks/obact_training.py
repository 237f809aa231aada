"""Where the time of ObAct's training goes: reading a sample, and each part of an update, on one thread.

python benchmarks/obact_training.py --root data/train_lean [--config recipes/train/obact_cpu.yaml] [--updates 30]

Medians of processor time, so that a busy machine blurs them little. Run it on datasets with and without the columns
that training does not use, in turns, to see what those cost.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import draccus
import lerobot_policy_obact  # noqa: F401  (registers the policy)
import torch
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.factory import make_dataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from torch.utils.data import default_collate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, required=True, help="dataset folder")
    parser.add_argument("--config", default="recipes/train/obact_cpu.yaml")
    parser.add_argument("--updates", type=int, default=30)
    args = parser.parse_args()
    torch.set_num_threads(1)
    config = draccus.parse(TrainPipelineConfig, args.config, args=[f"--dataset.root={args.root}"])
    watch = Watch()
    print(f"{len(read_and_update(config, args.updates, watch))} columns a sample")
    for part, seconds in watch.parts.items():
        print(f"{part:16} {1e3 * statistics.median(seconds):7.1f} ms")


class Watch:
    """Collects processor times by name [s]."""

    def __init__(self) -> None:
        self.parts: dict[str, list[float]] = defaultdict(list)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Measure what is done inside."""
        start = time.process_time()
        yield
        self.parts[part].append(time.process_time() - start)


def read_and_update(config: TrainPipelineConfig, updates: int, watch: Watch) -> dict[str, torch.Tensor]:
    """Train on freshly read batches as LeRobot does; return the last batch."""
    dataset = make_dataset(config)
    policy = make_policy(config.policy, ds_meta=dataset.meta).train()
    preprocess, _ = make_pre_post_processors(config.policy, dataset_stats=dataset.meta.stats)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-4)
    order = torch.randperm(len(dataset), generator=torch.Generator().manual_seed(0)).tolist()
    dataset[order[-1]]  # the first sample opens files
    batch = {}
    for _ in range(updates):
        samples = []
        for index in (order.pop() for _ in range(config.batch_size)):
            with watch("read a sample"):
                samples.append(dataset[index])
        batch = default_collate(samples)
        with watch("prepare"):
            floats = {key: batch[key] / 255.0 for key in dataset.meta.camera_keys if batch[key].dtype == torch.uint8}
            ready = preprocess(batch | floats)
        with watch("loss"):
            loss, _ = policy(ready)
        with watch("gradient"):
            loss.backward()
        with watch("optimiser"):
            torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
            optimizer.step()
            optimizer.zero_grad()
        with watch("average"):
            policy.update()
    return batch


if __name__ == "__main__":
    main()
