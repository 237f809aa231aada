"""CPU time of the ray caster for one picture, on one thread, from the hand's camera and from the side.

python benchmarks/rendering.py [--image-size 128] [--repeats 30] [--renderer tiles] [--json FILE]

CPU time hardly depends on what else the machine does. To compare revisions, run the script in checkouts of both, in
turns (A B A B). Worlds hold one episode of every kind, where its control phase begins.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.renderers import RENDERERS
from dynahoi_lerobot.renderers.camera_views import CAMERAS
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene.model import SIDE_CAMERA
from dynahoi_lerobot.world.batch import WorldBatch

KINDS = 22
TINY = {"image_size": 32, "repeats": 1}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--image-size", type=int, default=128, help="side of the square pictures [px]")
    parser.add_argument(
        "--repeats", type=int, default=30, help="calls that draw all worlds, of which the median counts"
    )
    parser.add_argument("--renderer", default="tiles", choices=RENDERERS.names())
    args = parser.parse_args()
    batch = _worlds(args)
    lines = {view: _microseconds(batch, view, args.repeats) for view in CAMERAS}
    for view, taken in lines.items():
        print(f"{view:5} {taken:6.0f} us/picture {1e6 / taken:7.0f} pictures/s of CPU time")
    write_numbers(args, us_per_picture=lines)


def _worlds(args: argparse.Namespace) -> WorldBatch:
    specs = sample_specs(Recipe(split="test"), range(KINDS))
    batch = WorldBatch(KINDS, threads=1, image_size=args.image_size, renderer=args.renderer, views=(SIDE_CAMERA,))
    batch.reset(range(KINDS), specs)
    while not batch.acting.all():
        batch.step(batch.executed)
    return batch


def _microseconds(batch: WorldBatch, view: str, repeats: int) -> float:
    """Median CPU time of one picture [us], once the kernels are compiled."""
    batch.cameras.render(view=view)
    taken = []
    for _ in range(repeats):
        begin = time.process_time()
        batch.cameras.render(view=view)
        taken.append(time.process_time() - begin)
    return float(np.median(taken)) / batch.size * 1e6


if __name__ == "__main__":
    main()
