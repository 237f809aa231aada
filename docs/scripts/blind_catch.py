"""Draw docs/blind_catch.gif: what a policy sees under protocol observe_then_blind, and what happens meanwhile.

The right half is the same commands, played again from the seed under the ordinary protocol, seen from the side.

python -m docs.scripts.blind_catch --policy CHECKPOINT --seed 60
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from dynahoi_lerobot.agent import Actor
from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.evaluate.actors import image_size_for, make_actor
from dynahoi_lerobot.evaluate.gif import phases_of, write_gif
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ, EGO_VIEW
from dynahoi_lerobot.protocol import DEFAULT_PROTOCOL
from dynahoi_lerobot.rollout.loop import evaluate, make_batch
from dynahoi_lerobot.rollout.replay import ActionLog, replay
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene.model import SIDE_CAMERA

OUT = Path(__file__).parents[1] / "blind_catch.gif"
PANEL_PX, LABEL_PX = 256, 14
SIDE_PART = (0.2, 0.2, 2 / 3)
"""Left, top and side of the part of the side view that is shown, as shares of its picture."""
SKIP, FRAMES_AFTER_CATCH = 2, 16
"""Every second frame is shown, at half the rate, until so many frames after the target was localised."""


def main() -> None:
    """Write the clip of the episode that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="expert", help="a checkpoint, or the name of an expert")
    parser.add_argument("--seed", type=int, default=60, help="seed within split test")
    parser.add_argument("--caption", default="", help="line under the clip; says policy and instruction if left out")
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    blind = play_blind(make_actor(args.policy), args.seed)
    caption = args.caption or f"{blind.meta.agent}: {blind.meta.task} {blind.stage}"
    print(write_clip(args.out, blind, seen_again(blind), caption), blind.stage)


def play_blind(actor: Actor, seed: int, image_size: int | None = None) -> Episode:
    """Return the episode of ``seed`` under ``observe_then_blind``, with what ``actor`` saw."""
    size = image_size_for(actor, image_size, PANEL_PX)
    recipe = Recipe(split="test", protocol="observe_then_blind", image_size=size)
    return next(evaluate(make_batch(recipe, 1), actor, sample_specs(recipe, [seed]), images=True))


def seen_again(blind: Episode, image_size: int = round(PANEL_PX / SIDE_PART[2])) -> Episode:
    """Return the episode that the same commands lead to where cameras are never black.

    Raises:
        RuntimeError: if it is another one, which the same code does not do.
    """
    recipe = Recipe(split="test", protocol=DEFAULT_PROTOCOL, image_size=image_size, views=(SIDE_CAMERA,))
    (seen,) = replay(recipe, [ActionLog(blind.meta.seed, blind.action, blind.meta.attempts)])
    if not (np.array_equal(seen.state, blind.state) and np.array_equal(seen.target_pose, blind.target_pose)):
        raise RuntimeError(f"the commands of seed {blind.meta.seed} led elsewhere when they were played again")
    return seen


def write_clip(path: Path, blind: Episode, seen: Episode, caption: str) -> Path:
    """Write both episodes side by side until soon after the target was localised."""
    end = len(blind) if blind.first_localized is None else blind.first_localized + FRAMES_AFTER_CATCH
    shown = slice(0, end, SKIP)
    side = _part(seen.images[SIDE_CAMERA][shown])
    eyes = _enlarged(blind.images[EGO_VIEW][shown], side.shape[1])
    panels = {"what the policy sees": eyes, "what happens": side}
    frames = np.concatenate([_labelled(frames, label) for label, frames in panels.items()], axis=2)
    return write_gif(path, frames, fps=CONTROL_HZ / SKIP, caption=caption, phases=phases_of(blind)[shown])


def _part(frames: np.ndarray) -> np.ndarray:
    """(T, h, h, 3): the part of (T, H, H, 3) frames that ``SIDE_PART`` names."""
    left, top, side = (round(share * frames.shape[1]) for share in SIDE_PART)
    return frames[:, top : top + side, left : left + side]


def _enlarged(frames: np.ndarray, side_px: int) -> np.ndarray:
    """(T, side_px, side_px, 3), every pixel repeated."""
    rows = np.arange(side_px) * frames.shape[1] // side_px
    return frames[:, rows][:, :, rows]


def _labelled(frames: np.ndarray, label: str) -> np.ndarray:
    """(T, LABEL_PX + H, W, 3): the frames under a line of text."""
    title = Image.new("RGB", (frames.shape[2], LABEL_PX))
    ImageDraw.Draw(title).text((3, 1), label, fill="white")
    titles = np.broadcast_to(np.asarray(title), (len(frames), LABEL_PX, frames.shape[2], 3))
    return np.concatenate([titles, frames], axis=1)


if __name__ == "__main__":
    main()
