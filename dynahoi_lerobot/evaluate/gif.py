"""Camera frames of an episode as a GIF, with a coloured border for the phase and a caption."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.atomic import write_atomically
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ, EGO_VIEW

if TYPE_CHECKING:
    from PIL import Image

BORDERS = {"observing": (128, 128, 128), "acting": (30, 30, 34), "localized": (46, 160, 67)}
"""Border colour [RGB, 0 to 255] of each phase: grey while observing, dark while acting, green once localised."""

BORDER_PX = 3
CAPTION_PX = 16
COLOURS, PALETTE_PAGES = 128, 8
"""Colours of a GIF, and how many of its pages they are chosen from."""
MAX_FPS = 50
"""Viewers slow anything faster down to 10 frames per second."""


def episode_gif(path: Path, episode: Episode, caption: str | None = None, min_width: int = 192) -> Path:
    """Write the hand camera's images of one episode as a GIF at real-time speed.

    Args:
        path: the file to write.
        episode: an episode with images.
        caption: the line under the image; None says motion, object and stage.
        min_width: least width of the frames [px]; smaller ones are enlarged by a whole factor.

    Returns:
        ``path``.

    Raises:
        ValueError: if the episode has no images.
    """
    frames = episode.images.get(EGO_VIEW)
    if frames is None:
        raise ValueError(f"the episode with seed {episode.meta.seed} holds no images; play it with a renderer")
    text = f"{episode.meta.motion} · {episode.meta.object} · {episode.stage}" if caption is None else caption
    return write_gif(path, frames, caption=text, phases=phases_of(episode), min_width=min_width)


def phases_of(episode: Episode) -> list[str]:
    """Return ``observing``, ``acting`` or ``localized`` for each of the episode's T frames."""
    return frame_phases(np.arange(len(episode)) >= episode.meta.window_frames, episode.localized)


def frame_phases(acting: np.ndarray, localized: np.ndarray) -> list[str]:
    """Return the name of each frame's phase.

    Args:
        acting: (T,) bool, whether the frame belongs to the control phase.
        localized: (T,) bool, whether the target has been localised by then.
    """
    return np.where(acting, np.where(localized, "localized", "acting"), "observing").tolist()


def write_gif(
    path: Path,
    frames: np.ndarray,
    *,
    fps: float = CONTROL_HZ,
    caption: str = "",
    phases: Sequence[str] | None = None,
    min_width: int = 0,
) -> Path:
    """Write frames as a GIF that repeats forever, whole or not at all.

    Args:
        path: the file to write.
        frames, fps, caption, phases, min_width: as ``encode_gif`` takes them.

    Returns:
        ``path``.

    Raises:
        ValueError: as ``encode_gif``.
    """
    data = encode_gif(frames, fps=fps, caption=caption, phases=phases, min_width=min_width)
    write_atomically({Path(path): lambda draft: draft.write_bytes(data)})
    return Path(path)


def encode_gif(
    frames: np.ndarray,
    *,
    fps: float = CONTROL_HZ,
    caption: str = "",
    phases: Sequence[str] | None = None,
    min_width: int = 0,
) -> bytes:
    """Return frames as the bytes of a GIF that repeats forever.

    Args:
        frames: (T, H, W, 3) uint8 RGB.
        fps: frames per second, at most 50; the format rounds the duration of a frame to 10 ms.
        caption: text for a strip under the image; empty leaves the strip out.
        phases: T names out of ``BORDERS``, or None for no border.
        min_width: least width of the frames [px]; smaller ones are enlarged by a whole factor, so that pixels stay
            crisp.

    Raises:
        ValueError: if the frames, the frame rate or the phases are not as described.
    """
    _check(frames, fps, phases)
    scale = max(1, -(-min_width // frames.shape[2]))
    names = phases or [None] * len(frames)
    pages = _quantized([_page(frame, name, caption, scale) for frame, name in zip(frames, names, strict=True)])
    options = {"save_all": True, "append_images": pages[1:], "duration": round(100 / fps) * 10, "loop": 0}
    buffer = io.BytesIO()
    pages[0].save(buffer, "GIF", **options)
    return buffer.getvalue()


def _check(frames: np.ndarray, fps: float, phases: Sequence[str] | None) -> None:
    if frames.ndim != 4 or frames.shape[-1] != 3 or frames.dtype != np.uint8 or 0 in frames.shape:
        raise ValueError(f"a GIF needs (T, H, W, 3) uint8 frames, not {frames.shape} {frames.dtype}")
    if not 0 < fps <= MAX_FPS:
        raise ValueError(f"a GIF plays at up to {MAX_FPS} frames per second, not {fps}")
    if phases is not None and (len(phases) != len(frames) or not set(phases) <= set(BORDERS)):
        raise ValueError(
            f"phases must be {len(frames)} names out of {', '.join(BORDERS)}, not {len(phases)} of "
            f"{', '.join(sorted(set(phases)))}"
        )


def _page(frame: np.ndarray, phase: str | None, caption: str, scale: int) -> Image.Image:
    from PIL import Image, ImageOps

    picture = Image.fromarray(np.repeat(np.repeat(frame, scale, axis=0), scale, axis=1))
    if phase is not None:
        picture = ImageOps.expand(picture, BORDER_PX, BORDERS[phase])
    return _captioned(picture, caption) if caption else picture


def _quantized(pages: Sequence[Image.Image]) -> list[Image.Image]:
    """Give all pages the same colours, so that what stands still does not flicker and is stored once."""
    from PIL import Image

    few = [pages[i] for i in np.linspace(0, len(pages) - 1, min(PALETTE_PAGES, len(pages))).astype(int)]
    octree = Image.Quantize.FASTOCTREE  # median cut would drop the colour of a small target
    learned = Image.fromarray(np.vstack(few)).quantize(COLOURS - len(BORDERS), octree).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*np.ravel(list(BORDERS.values())).tolist(), *learned])
    return [page.quantize(palette=palette, dither=Image.Dither.NONE) for page in pages]


def _captioned(picture: Image.Image, caption: str) -> Image.Image:
    from PIL import Image, ImageDraw, ImageFont

    page = Image.new("RGB", (picture.width, picture.height + CAPTION_PX), (30, 30, 34))
    page.paste(picture)
    font = ImageFont.load_default(size=11)
    while caption and font.getlength(caption) > page.width - 8:
        caption = caption[:-2].rstrip("…") + "…" if len(caption) > 2 else ""
    ImageDraw.Draw(page).text((4, picture.height + 1), caption, fill=(235, 235, 235), font=font)
    return page
