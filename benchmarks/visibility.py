"""In how many episodes does the camera see the target while the hand waits?

python benchmarks/visibility.py [--episodes 110] [--split test] [--image-size 64] [--json FILE]

An episode counts as seen if at least one pixel of the target shows in at least 80 % of the window's frames; every
second frame is rendered. Prints, for each kind, that share, the share of frames, and the median number of pixels.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from support.options import benchmark_parser, write_numbers
from tqdm import tqdm

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

SEEN_SHARE = 0.8
EVERY = 2
WORLDS = 22


@dataclass(frozen=True)
class Watched:
    """How much of one episode's window showed the target: (F,) pixels in each rendered frame."""

    kind: str
    pixels: np.ndarray

    @property
    def share(self) -> float:
        """Share of frames that show it."""
        return float((self.pixels > 0).mean())

    @property
    def seen(self) -> bool:
        """Whether that is enough."""
        return self.share >= SEEN_SHARE


def main() -> None:
    parser = benchmark_parser(__doc__, episodes=2, image_size=32)
    parser.add_argument("--episodes", type=int, default=110)
    parser.add_argument("--split", default="test")
    parser.add_argument("--image-size", type=int, default=64)
    args = parser.parse_args()
    recipe = Recipe(split=args.split, image_size=args.image_size)
    batch = make_batch(recipe, min(WORLDS, args.episodes), threads=1)
    watched = []
    for first in tqdm(range(0, args.episodes, batch.size)):
        seeds = range(first, min(first + batch.size, args.episodes))
        watched += watch(batch, sample_specs(recipe, seeds))
    table = summarize(watched)
    print(f"{'kind':20s} seen %  frames %  median pixels")
    for kind, row in table.items():
        print(f"{kind:20s} {100 * row['seen']:6.1f} {100 * row['frames']:9.1f} {row['pixels']:14.0f}")
    write_numbers(args, kinds=table)


def watch(batch: WorldBatch, specs: list[EpisodeSpec]) -> list[Watched]:
    """Play the windows of at most ``batch.size`` episodes and count the target's pixels."""
    ids = np.arange(len(specs))
    batch.reset(ids, specs)
    pixels: list[list[int]] = [[] for _ in specs]
    for frame in range(max(spec.window_frames for spec in specs)):
        if frame % EVERY == 0:
            shown = np.isin(batch.cameras.segmentation(), batch.scene.target_geoms).sum(axis=(1, 2))
            for i, spec in enumerate(specs):
                if frame < spec.window_frames:
                    pixels[i].append(int(shown[i]))
        batch.step(batch.executed[ids], ids)
    return [Watched(spec.motion.name, np.array(counts)) for spec, counts in zip(specs, pixels, strict=True)]


def summarize(watched: list[Watched]) -> dict[str, dict[str, float]]:
    """Return, for each kind and for ``all``, the shares of episodes seen and of frames, and the median of pixels."""
    groups = defaultdict(list)
    for one in watched:
        groups[one.kind].append(one)
    return {
        kind: {
            "seen": float(np.mean([one.seen for one in group])),
            "frames": float(np.mean([one.share for one in group])),
            "pixels": float(np.median(np.concatenate([one.pixels for one in group]))),
        }
        for kind, group in [*sorted(groups.items()), ("all", watched)]
    }


if __name__ == "__main__":
    main()
