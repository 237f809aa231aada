"""Draw docs/look_after.jpg: every kind of motion and every object, from the hand's camera and from the side.

python benchmarks/look.py [--out docs/look_after.jpg] [--tile-px 256] [--json FILE]

Each pair of pictures shows the frame at which the control phase is halfway to the intercept, under the expert.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from contact_sheet import one_episode_per_kind
from PIL import Image
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.scene.model import SIDE_CAMERA

COLUMNS, JPEG_QUALITY = 4, 82
TINY = {"out": Path("look.jpg"), "tile_px": 32, "motions": ["constant", "lob"]}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--out", type=Path, default=Path("docs/look_after.jpg"))
    parser.add_argument(
        "--motions", nargs="+", default=Recipe(split="test").motion_names, help="kinds to draw; all if left out"
    )
    parser.add_argument("--tile-px", type=int, default=256, help="side of a picture [px]")
    args = parser.parse_args()
    recipe = Recipe(split="test", image_size=args.tile_px, views=(SIDE_CAMERA,))
    specs = one_episode_per_kind(recipe, args.motions)
    batch = make_batch(recipe, min(11, len(specs)))
    episodes = list(evaluate(batch, EXPERTS["intercept"](), specs, images=True))
    pairs = [_pair(episode) for episode in episodes]
    pairs += [np.zeros_like(pairs[0])] * (-len(pairs) % COLUMNS)
    rows = [np.hstack(pairs[i : i + COLUMNS]) for i in range(0, len(pairs), COLUMNS)]
    Image.fromarray(np.vstack(rows)).save(args.out, quality=JPEG_QUALITY)
    kinds, objects = [e.meta.motion for e in episodes], sorted({e.meta.object for e in episodes})
    print(f"{args.out}: {len(kinds)} kinds, {len(objects)} objects")
    write_numbers(args, kinds=kinds, objects=objects)


def _pair(episode: Episode) -> np.ndarray:
    """(H, 2 W, 3) uint8: both cameras halfway between the start of control and the intercept."""
    frame = (episode.meta.window_frames + episode.meta.intercept_frame) // 2
    return np.hstack([episode.images[EGO_CAMERA][frame], episode.images[SIDE_CAMERA][frame]])


if __name__ == "__main__":
    main()
