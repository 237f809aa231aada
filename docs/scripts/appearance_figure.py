"""Draw docs/appearance.jpg: seven episodes in the default appearance, with each randomisation, and with all of them.

python -m docs.scripts.appearance_figure
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.rollout.loop import make_batch
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS, randomize_appearance
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs

OUT = Path(__file__).parents[1] / "appearance.jpg"
KINDS = ("lob", "planar", "struck", "vertical_circle", "ramp", "lateral", "random_spline")
ROWS = {"default": (), **{name: (name,) for name in RANDOMIZATIONS}, "all": tuple(RANDOMIZATIONS)}
"""Randomisations of each row, by its label."""
JPEG_QUALITY = 85
TILE_PX, LABEL_PX = 128, 14
"""Side of a picture and height of a row's label [px]."""


def main() -> None:
    """Write the figure."""
    draw().save(OUT, quality=JPEG_QUALITY, subsampling=0)
    print(OUT)


def draw(tile_px: int = TILE_PX) -> Image.Image:
    """Return the figure: a column for each episode, a row for each appearance, at the first frame."""
    specs = [sample_specs(Recipe(split="test", motions=(kind,)), [seed])[0] for seed, kind in enumerate(KINDS)]
    strips = [
        _strip(name, [randomize_appearance(spec, names) for spec in specs], tile_px) for name, names in ROWS.items()
    ]
    return Image.fromarray(np.vstack(strips))


def _strip(label: str, specs: list[EpisodeSpec], tile_px: int) -> np.ndarray:
    """(LABEL_PX + H, N W, 3) uint8: the first picture of each episode under a label."""
    batch = make_batch(Recipe(split="test", image_size=tile_px), len(specs))
    batch.reset(range(len(specs)), specs)
    tiles = np.hstack(list(batch.cameras.render()))
    title = Image.new("RGB", (tiles.shape[1], LABEL_PX))
    ImageDraw.Draw(title).text((3, 1), label, fill="white")
    return np.vstack([np.asarray(title), tiles])


if __name__ == "__main__":
    main()
