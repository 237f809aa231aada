"""Draw docs/offsets.png: what a target 0.3 u beside the palm centre looks like, at the threshold of localisation.

The paper's figure "Qualitative visualization of target offsets" moves the target along X and Z of its world, across
and ahead of the hand; these are our y and x.

python -m docs.scripts.offset_figure
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import LOCALIZATION_RADIUS_M
from dynahoi_lerobot.motions.straight_line import Constant
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

OUT = Path(__file__).parents[1] / "offsets.png"
OFFSETS_M = {
    "centred": (0.0, 0.0, 0.0),
    "ahead +0.3 u": (LOCALIZATION_RADIUS_M, 0.0, 0.0),
    "ahead -0.3 u": (-LOCALIZATION_RADIUS_M, 0.0, 0.0),
    "aside +0.3 u": (0.0, LOCALIZATION_RADIUS_M, 0.0),
    "aside -0.3 u": (0.0, -LOCALIZATION_RADIUS_M, 0.0),
}
"""Target centre minus palm centre [m], world; the palm faces +x."""
VIEWS = {"ego": (0.0, 0.0, 1.0), "side": (0.14, 0.4, 1 / 3)}
"""Left, top and side of the part of each view that is shown, as shares of its picture."""
OVERSAMPLING = 3
TILE_PX, LABEL_PX = 192, 14
"""Side of a picture and height of its label [px]."""
STILL_M_S = 1e-6


def main() -> None:
    """Write the figure."""
    draw().save(OUT, optimize=True)
    print(OUT)


def draw(tile_px: int = TILE_PX) -> Image.Image:
    """Return the figure: a column for each offset, the hand's camera above the one beside it."""
    batch = offset_worlds(OVERSAMPLING * tile_px)
    sheet = Image.new("RGB", (tile_px * len(OFFSETS_M), tile_px * len(VIEWS) + LABEL_PX))
    pictures = {view: batch.cameras.render(None, view) for view in VIEWS}  # (5, H, W, 3) each
    for column, name in enumerate(OFFSETS_M):
        ImageDraw.Draw(sheet).text((column * tile_px + 3, 1), name, fill="white")
        for row, view in enumerate(VIEWS):
            shown = _part(Image.fromarray(pictures[view][column]), VIEWS[view])
            sheet.paste(
                shown.resize((tile_px, tile_px), Image.Resampling.BOX), (column * tile_px, LABEL_PX + row * tile_px)
            )
    return sheet


def _part(picture: Image.Image, part: tuple[float, float, float]) -> Image.Image:
    left, top, side = (round(share * picture.width) for share in part)
    return picture.crop((left, top, left + side, top + side))


def offset_worlds(image_size: int) -> WorldBatch:
    """Return worlds of one ball that rests at each of ``OFFSETS_M`` from the palm centre of an open hand."""
    (spec,) = sample_specs(Recipe(split="test", motions=("constant",), objects=("ball",)), [0])
    batch = WorldBatch(len(OFFSETS_M), image_size=image_size, views=("side",))
    batch.reset(range(len(OFFSETS_M)), [_resting(spec, np.array(offset_m)) for offset_m in OFFSETS_M.values()])
    return batch


def _resting(spec: EpisodeSpec, offset_m: np.ndarray) -> EpisodeSpec:
    """The episode with a target that stays ``offset_m`` (3,) from the home of the palm."""
    target_w = spec.home_pos_w + offset_m
    motion = Constant(tuple(target_w.tolist()), (0.0, 1.0, 0.0), 0.0, STILL_M_S, 0.0)
    return replace(spec, motion=motion, oracle_path=np.tile(target_w, (spec.horizon_frames, 1)))


if __name__ == "__main__":
    main()
