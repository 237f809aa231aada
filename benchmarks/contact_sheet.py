"""Draw docs/contact_sheet.jpg: every kind of motion and every object, at the start, at control start and when caught.

python benchmarks/contact_sheet.py [--out docs/contact_sheet.jpg] [--json FILE]
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

LABEL_PX, COLUMNS = 12, 4
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
TINY = {"out": Path("contact_sheet.jpg"), "tile_px": 32, "motions": ["constant", "lob"]}


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--out", type=Path, default=Path("docs/contact_sheet.jpg"))
    parser.add_argument(
        "--motions", nargs="+", default=Recipe(split="test").motion_names, help="kinds to draw; all if left out"
    )
    parser.add_argument("--tile-px", type=int, default=96, help="side of a picture [px]")
    args = parser.parse_args()
    recipe = Recipe(split="test", image_size=args.tile_px)
    specs = one_episode_per_kind(recipe, args.motions)
    episodes = list(evaluate(WorldBatch(recipe, min(11, len(specs))), EXPERTS["intercept"](), specs, images=True))
    episodes.sort(key=lambda episode: (episode.meta.category, episode.meta.motion))
    strips = [_strip(episode) for episode in episodes]
    strips += [np.zeros_like(strips[0])] * (-len(strips) % COLUMNS)
    sheet = np.vstack([np.hstack(strips[i : i + COLUMNS]) for i in range(0, len(strips), COLUMNS)])
    cv2.imwrite(str(args.out), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), JPEG)
    kinds, objects = [e.meta.motion for e in episodes], sorted({e.meta.object for e in episodes})
    print(f"{args.out}: {len(kinds)} kinds, {len(objects)} objects")
    write_numbers(args, kinds=kinds, objects=objects)


def one_episode_per_kind(recipe: Recipe, motions: Sequence[str]) -> list[EpisodeSpec]:
    """Return one episode per kind, whose objects take turns as far as the kind allows."""
    specs, unused = [], set(recipe.object_names)
    suited = {name: sum(MOTIONS[name].suits(kind) for _, kind in OBJECTS.items()) for name in motions}
    for number, kind in enumerate(sorted(motions, key=suited.__getitem__)):
        allowed = sorted(name for name in recipe.object_names if MOTIONS[kind].suits(OBJECTS[name]))
        fresh = [name for name in allowed if name in unused] or allowed
        name = fresh[number % len(fresh)]
        unused.discard(name)
        specs += sample_specs(replace(recipe, motions=(kind,), objects=(name,)), [number])
    return specs


def _strip(episode: Episode) -> np.ndarray:
    """Return the label and three moments of an episode, (H, W, 3) uint8 RGB."""
    caught = episode.first_localized or len(episode) - 1
    moments = (0, episode.meta.window_frames, min(caught + 2, len(episode) - 1))
    images = np.hstack([episode.images["ego"][frame] for frame in moments])
    strip = cv2.copyMakeBorder(images, LABEL_PX, 4, 0, 4, cv2.BORDER_CONSTANT, value=(0, 0, 0))
    label = f"{episode.meta.motion}, {episode.meta.object}"
    return cv2.putText(strip, label, (2, LABEL_PX - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.35, (255, 255, 255))


if __name__ == "__main__":
    main()
