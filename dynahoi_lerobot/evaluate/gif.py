"""Camera frames of an episode as a GIF, with a colored border for the phase and a caption."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_HZ, EGO_VIEW
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.files import write_atomically

if TYPE_CHECKING:
    from PIL import Image

BORDERS = {"observing": (128, 128, 128), "acting": (30, 30, 34), "localized": (46, 160, 67)}
"""Border color [RGB, 0 to 255] of each phase: gray while observing, dark while acting, green once
localized."""

BORDER_PX = 3
CAPTION_PX = 16
STRIP = (30, 30, 34)
INK = (235, 235, 235)
FONT = cv2.FONT_HERSHEY_SIMPLEX
FONT_SCALE = 0.38
COLORS = 128
PALETTE_PAGES = 8
"""Colors of a GIF, and how many of its pages they are chosen from."""
EPISODE_PX = 192
"""Least width of an episode's frames."""


def episode_gif(path: Path, episode: Episode) -> None:
    """Write the hand camera's images of one episode as a GIF at real-time speed, with motion,
    object and stage.

    Raises:
        ValueError: if the episode has no images.
    """
    frames = episode.images.get(EGO_VIEW)
    if frames is None:
        raise ValueError(
            f"the episode with seed {episode.meta.seed} holds no images; play it with a renderer"
        )
    caption = f"{episode.meta.motion}, {episode.meta.object}: {episode.stage}"
    write_gif(path, frames, caption=caption, phases=phases_of(episode), min_width=EPISODE_PX)


def phases_of(episode: Episode) -> list[str]:
    """Return ``observing``, ``acting`` or ``localized`` for each of the episode's T frames."""
    return frame_phases(np.arange(len(episode)) >= episode.meta.window_frames, episode.localized)


def frame_phases(acting: np.ndarray, localized: np.ndarray) -> list[str]:
    """Return the T names, given (T,) bool each: it is in the control phase, the target has been
    localized by then.
    """
    return np.where(acting, np.where(localized, "localized", "acting"), "observing").tolist()


def write_gif(path: Path, frames: np.ndarray, **options: Any) -> None:
    """Write frames as a GIF that loops forever, whole or not at all; see ``encode_gif`` for the
    options.
    """
    data = encode_gif(frames, **options)
    write_atomically({path: lambda draft: draft.write_bytes(data)})


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
        fps: frames per second; the format rounds the duration of a frame to 10 ms, and one below 20
            ms becomes 20 ms, as viewers show it for 100 ms.
        caption: text for a strip under the image, cut to its width; empty leaves the strip out.
        phases: T names out of ``BORDERS``, or None for no border.
        min_width: least width of the frames [px]; smaller ones are enlarged by a whole factor, so
            that pixels stay crisp.
    """
    scale = max(1, -(-min_width // frames.shape[2]))
    names = phases or [None] * len(frames)
    pages = _quantized(
        [_page(frame, name, caption, scale) for frame, name in zip(frames, names, strict=True)]
    )
    options = {
        "save_all": True,
        "append_images": pages[1:],
        "duration": max(2, round(100 / fps)) * 10,
        "loop": 0,
    }
    buffer = io.BytesIO()
    pages[0].save(buffer, "GIF", **options)
    return buffer.getvalue()


def _page(frame: np.ndarray, phase: str | None, caption: str, scale: int) -> np.ndarray:
    """Return the frame enlarged, with its border and the strip for the caption, (H, W, 3) uint8
    RGB.
    """
    page = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    if phase is not None:
        sides = (BORDER_PX, BORDER_PX, BORDER_PX, BORDER_PX)
        page = cv2.copyMakeBorder(page, *sides, cv2.BORDER_CONSTANT, value=BORDERS[phase])
    return _captioned(page, caption) if caption else page


def _captioned(page: np.ndarray, caption: str) -> np.ndarray:
    height, width = page.shape[:2]
    page = cv2.copyMakeBorder(page, 0, CAPTION_PX, 0, 0, cv2.BORDER_CONSTANT, value=STRIP)
    text = caption[:width]  # no character is narrower than a pixel; OpenCV cuts the rest
    cv2.putText(page, text, (4, height + 11), FONT, FONT_SCALE, INK, lineType=cv2.LINE_AA)
    return page


def _quantized(pages: Sequence[np.ndarray]) -> list[Image.Image]:
    """Give all pages the same colors, so that what stands still does not flicker and is stored
    once.

    Pillow does this. OpenCV's own GIF encoder dithers, so that still pixels change and a small
    target loses its color.
    """
    from PIL import Image

    chosen = np.linspace(0, len(pages) - 1, min(PALETTE_PAGES, len(pages))).astype(int)
    few = Image.fromarray(np.vstack([pages[i] for i in chosen]))
    octree = Image.Quantize.FASTOCTREE  # median cut would drop the color of a small target
    learned = few.quantize(COLORS - len(BORDERS), octree).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*np.ravel(list(BORDERS.values())).tolist(), *learned])
    return [
        Image.fromarray(page).quantize(palette=palette, dither=Image.Dither.NONE) for page in pages
    ]
