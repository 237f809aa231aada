"""What LeRobot's dataset takes for a sample, with privileged columns in the frame table and without; in turns.

python benchmarks/columns.py [--episodes 16] [--image-size 64] [--samples 100] [--turns 3] [--json FILE]

Windows are the tracker's: 11 frames of every observation, 18 actions. Processor time of one process; on a busy machine
only ratios of one run mean something.

frames: ``dynahoi generate``. episodes: with ``--privileged-columns episodes``. lean: the latter without
``observation.fingertips``, which ``lerobot-edit-dataset`` removes. subtasks: the first with ``--subtasks``.
"""

from __future__ import annotations

import argparse
import logging
import tempfile
import time
from pathlib import Path
from statistics import median

from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.cli.main import main as dynahoi
from dynahoi_lerobot.dataset import open_dataset
from dynahoi_lerobot.foundation.conventions import CONTROL_DT

FRAMES, ACTIONS, STRIDE = 11, 18, 1
FINGERTIPS = "observation.fingertips"
TINY = {"episodes": 2, "image_size": 32, "samples": 2, "turns": 1}
OPTIONS = {"frames": [], "episodes": ["--privileged-columns", "episodes"], "subtasks": ["--subtasks"]}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--image-size", type=int, default=64)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--turns", type=int, default=3)
    args = parser.parse_args()
    logging.disable(logging.WARNING)
    with tempfile.TemporaryDirectory() as folder:
        roots = make_datasets(Path(folder), args)
        turns = [turn(roots, args.samples) for _ in range(args.turns)]
    lines = {name: median(measured[name] for measured in turns) for name in turns[0]}
    for name, ms in lines.items():
        print(f"{name:9} {ms:6.1f} ms a sample, {ms / lines['frames']:.2f} of frames")
    write_numbers(args, sample_ms=lines, turns=turns)


def turn(roots: dict[str, Path], samples: int) -> dict[str, float]:
    """Measure each dataset once [ms] and print it."""
    measured = {name: sample_ms(root, samples) for name, root in roots.items()}
    print("  ".join(f"{name} {ms:.1f}" for name, ms in measured.items()), flush=True)
    return measured


def make_datasets(folder: Path, args: argparse.Namespace) -> dict[str, Path]:
    """Generate the same episodes with each of the options, and remove a column from the leanest."""
    from lerobot.datasets.dataset_tools import remove_feature

    words = ["--episodes", str(args.episodes), "--image-size", str(args.image_size)]
    for name, options in OPTIONS.items():
        if dynahoi(["generate", "--root", str(folder / name), *words, *options]):
            raise RuntimeError(f"dynahoi generate {' '.join(options)} failed")
    remove_feature(open_dataset(folder / "episodes"), FINGERTIPS, output_dir=folder / "lean")
    return {name: folder / name for name in (*OPTIONS, "lean")}


def sample_ms(root: Path, samples: int) -> float:
    """Processor time of one random sample [ms]."""
    import torch

    past = [-STRIDE * step * CONTROL_DT for step in reversed(range(FRAMES))]
    keys = [key for key in open_dataset(root).meta.features if key.startswith("observation.")]
    window = dict.fromkeys(keys, past) | {"action": [step * CONTROL_DT for step in range(ACTIONS)]}
    dataset = open_dataset(root, delta_timestamps=window, video_backend="pyav")
    chosen = torch.randperm(len(dataset), generator=torch.Generator().manual_seed(0))[: samples + 2].tolist()
    for index in chosen[:2]:
        dataset[index]
    begin = time.process_time()
    for index in chosen[2:]:
        dataset[index]
    return 1000 * (time.process_time() - begin) / samples


if __name__ == "__main__":
    main()
