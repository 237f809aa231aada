"""How fast a dataset is written, how large it is and how fast LeRobot's dataloader reads it, by codec.

python benchmarks/load.py [--episodes 64] [--image-size 128] [--backend pyav] [--json FILE]

The window is ObAct's by default: the current and five earlier frames, two frames apart, and sixteen actions. Rates are
per second of processor time of one process, so that a busy machine does not blur them; ``--workers`` measures wall time
instead.
"""

import argparse
import logging
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.core.conventions import CONTROL_DT
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset import open_dataset, read_episodes, write_episodes
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.sampling.recipe import Recipe

STRIDE, PAST, HORIZON = 2, 5, 16
TINY = {"episodes": 2, "image_size": 32, "samples": 20, "only": "superfast g2 crf20"}

ENCODINGS = {
    "h264 ultrafast g2 crf20": Encoding("h264", 20, "ultrafast", 2),
    "h264 superfast g1 crf20": Encoding("h264", 20, "superfast", 1),
    "h264 superfast g2 crf20": Encoding("h264", 20, "superfast", 2),
    "h264 superfast g10 crf20": Encoding("h264", 20, "superfast", 10),
    "h264 superfast g2 crf23": Encoding("h264", 23, "superfast", 2),
    "images (PNG)": Encoding("images"),
}


@dataclass(frozen=True)
class Line:
    """One encoding's measurements."""

    encoding: str
    write_frames_s: float
    kib_frame: float
    psnr_db: float
    read_samples_s: float


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--image-size", type=int, default=128)
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--workers", type=int, default=0, help="dataloader processes")
    parser.add_argument("--backend", default="pyav", choices=("pyav", "torchcodec"))
    parser.add_argument("--only", default="", help="measure encodings whose name contains this")
    args = parser.parse_args()
    logging.disable(logging.WARNING)
    recipe = Recipe(image_size=args.image_size)
    episodes = list(record(recipe, range(args.episodes)))
    warm_up(episodes[:2], args)
    lines = []
    print(f"{'encoding':34} {'write frames/s':>14} {'KiB/frame':>10} {'PSNR dB':>8} {'read samples/s':>14}")
    for name, encoding in ENCODINGS.items():
        if args.only in name:
            lines.append(measure(name, encoding, episodes, args))
            print("{:34} {:14.0f} {:10.2f} {:8.1f} {:14.1f}".format(*asdict(lines[-1]).values()), flush=True)
    write_numbers(args, lines=[asdict(line) for line in lines])


def warm_up(episodes: Sequence[Episode], args: argparse.Namespace) -> None:
    """Import and compile whatever the first use imports and compiles."""
    measure("warm-up", Encoding(), episodes, args)


def measure(name: str, encoding: Encoding, episodes: Sequence[Episode], args: argparse.Namespace) -> Line:
    folder = Path(tempfile.mkdtemp())
    try:
        root = folder / "dataset"
        frames, begin = sum(len(episode) for episode in episodes), time.process_time()
        write_episodes(root, episodes, encoding)
        write_s = time.process_time() - begin
        size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
        reading = samples_per_second(root, args)
        return Line(name, frames / write_s, size / frames / 1024, psnr_db(root, episodes), reading)
    finally:
        shutil.rmtree(folder)


def samples_per_second(root: Path, args: argparse.Namespace) -> float:
    """Random windows through LeRobot's dataset and a torch dataloader [1/s]."""
    import torch

    torch.manual_seed(0)
    past = [-STRIDE * step * CONTROL_DT for step in range(PAST, -1, -1)]
    window = {"observation.images.ego": past, "observation.state": past}
    window["action"] = [step * CONTROL_DT for step in range(HORIZON)]
    dataset = open_dataset(root, delta_timestamps=window, video_backend=args.backend)
    sampler = torch.randperm(len(dataset))[: args.samples].tolist()
    loader = torch.utils.data.DataLoader(dataset, batch_size=10, sampler=sampler, num_workers=args.workers)
    batches = iter(loader)
    next(batches)
    clock = time.perf_counter if args.workers else time.process_time
    begin = clock()
    seen = sum(len(batch["action"]) for batch in batches)
    return seen / (clock() - begin)


def psnr_db(root: Path, episodes: Sequence[Episode]) -> float:
    """Peak signal-to-noise ratio of the first episodes' images [dB]; infinite if nothing is lost."""
    pairs = zip(episodes, read_episodes(root, range(min(8, len(episodes)))), strict=False)
    errors = [np.mean((one.images["ego"].astype(float) - other.images["ego"]) ** 2) for one, other in pairs]
    return float(10 * np.log10(255**2 / np.mean(errors))) if any(errors) else float("inf")


if __name__ == "__main__":
    main()
