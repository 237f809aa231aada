"""Draw docs/contact_sheet.png: every kind of motion and every object, at the start, at control start and when caught.

python benchmarks/contact_sheet.py [--out docs/contact_sheet.png]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

TILE_PX, LABEL_PX, COLUMNS = 96, 12, 4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/contact_sheet.png"))
    out = parser.parse_args().out
    recipe = Recipe(split="test", image_size=TILE_PX)
    episodes = list(evaluate(make_batch(recipe, 11), EXPERTS["intercept"](), _specs(recipe), images=True))
    episodes.sort(key=lambda episode: (episode.meta.category, episode.meta.motion))
    strips = [_strip(episode) for episode in episodes]
    strips += [Image.new("RGB", strips[0].size)] * (-len(strips) % COLUMNS)
    rows = [np.hstack([np.asarray(s) for s in strips[i : i + COLUMNS]]) for i in range(0, len(strips), COLUMNS)]
    Image.fromarray(np.vstack(rows)).save(out, optimize=True)
    print(f"{out}: {len(episodes)} kinds, {len({e.meta.object for e in episodes})} objects")


def _specs(recipe: Recipe) -> list:
    """One episode per kind, whose objects take turns as far as the kind allows."""
    specs, unused = [], set(recipe.object_names)
    for number, kind in enumerate(sorted(recipe.motion_names, key=lambda name: len(MOTIONS[name].objects()))):
        allowed = sorted(set(MOTIONS[kind].objects()) & set(recipe.object_names))
        fresh = [name for name in allowed if name in unused] or allowed
        name = fresh[number % len(fresh)]
        unused.discard(name)
        specs += sample_specs(replace(recipe, motions=(kind,), objects=(name,)), [number])
    return specs


def _strip(episode: Episode) -> Image.Image:
    caught = episode.first_localized or len(episode) - 1
    moments = (0, episode.meta.window_frames, min(caught + 2, len(episode) - 1))
    strip = Image.new("RGB", (TILE_PX * len(moments) + 4, TILE_PX + LABEL_PX + 4))
    ImageDraw.Draw(strip).text((2, 0), f"{episode.meta.motion} · {episode.meta.object}", fill="white")
    for column, frame in enumerate(moments):
        strip.paste(Image.fromarray(episode.images["ego"][frame]), (column * TILE_PX, LABEL_PX))
    return strip


if __name__ == "__main__":
    main()
