"""Where the time of the tracker's training goes: reading a sample, and each part of an update, on one thread.

python benchmarks/tracker_training.py [--root data/train_lean] [--config recipes/train/tracker_cpu.yaml] [--updates 30]

Medians of processor time, so that a busy machine blurs them little. Run it on datasets with and without the columns
that training does not use, in turns, to see what those cost; without ``--root`` it generates a small one with all.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import draccus
import lerobot_policy_tracker  # noqa: F401  (registers the policy)
import torch
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.factory import make_dataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from support.options import benchmark_parser, write_numbers
from torch.utils.data import default_collate

from dynahoi_lerobot.dataset import write_episodes
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import load_recipe

RECIPES = Path(__file__).parents[1] / "recipes"
TINY = {"updates": 2, "episodes": 1, "batch_size": 2}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--root", type=Path, help="dataset folder")
    parser.add_argument("--episodes", type=int, default=16, help="episodes to generate where no folder is given")
    parser.add_argument("--config", type=Path, default=RECIPES / "train" / "tracker_cpu.yaml")
    parser.add_argument("--batch-size", type=int, default=32)
    parser.add_argument("--updates", type=int, default=30)
    args = parser.parse_args()
    torch.set_num_threads(1)
    watch = Watch()
    with tempfile.TemporaryDirectory() as folder:
        root = args.root or generated(Path(folder) / "dataset", args.episodes)
        words = [f"--dataset.root={root}", f"--batch_size={args.batch_size}", "--policy.device=cpu"]
        columns = len(read_and_update(draccus.parse(TrainPipelineConfig, args.config, args=words), args.updates, watch))
    print(f"{columns} columns a sample")
    milliseconds = {part: 1e3 * statistics.median(seconds) for part, seconds in watch.parts.items()}
    for part, median in milliseconds.items():
        print(f"{part:16} {median:7.1f} ms")
    write_numbers(args, columns=columns, milliseconds=milliseconds)


def generated(root: Path, episodes: int) -> Path:
    """Write a few episodes of the recipe that the tracker trains on, with every column; return the folder."""
    recipe = load_recipe(RECIPES / "generate" / "train_small.yaml")
    write_episodes(root, record(recipe, range(episodes)))
    return root


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
