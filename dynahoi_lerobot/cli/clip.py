"""A clip and its file: GIF, MP4, or a web page that holds the GIF."""

from __future__ import annotations

import base64
import html
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from dynahoi_lerobot.evaluate.gif import encode_gif
from dynahoi_lerobot.foundation.atomic import write_atomically
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ

MIN_WIDTH_PX = 384
"""Least width of a GIF; smaller frames are enlarged."""

PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{caption}</title>
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<style>body{{font:16px system-ui;background:#111;color:#ddd;text-align:center}}img{{image-rendering:pixelated}}</style>
<p>{caption}</p><img alt="{caption}" src="data:image/gif;base64,{data}">"""


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames of one episode.

    Attributes:
        frames: (T, H, W, 3) uint8 RGB.
        caption: one line of text.
        phases: ``observing``, ``acting`` or ``localized`` for each frame; None if they are not known.
        fps: frames per second.
    """

    frames: np.ndarray
    caption: str
    phases: list[str] | None
    fps: float = CONTROL_HZ


def write_clip(path: Path, clip: Clip) -> None:
    """Write ``clip`` atomically, in the format of the suffix of ``path``; create folders.

    Raises:
        ValueError: as ``check_suffix``, or if the frames cannot be encoded.
    """
    check_suffix(path)
    write_atomically({path: lambda draft: WRITERS[path.suffix](draft, clip)})


def check_suffix(path: Path) -> None:
    """Refuse an unknown file format.

    Raises:
        ValueError: naming the suffix received and those allowed.
    """
    if path.suffix not in WRITERS:
        raise ValueError(f"cannot write {path.suffix or 'a file without suffix'!r}; use {', '.join(WRITERS)}")


def _gif(clip: Clip) -> bytes:
    return encode_gif(clip.frames, fps=clip.fps, caption=clip.caption, phases=clip.phases, min_width=MIN_WIDTH_PX)


def _write_gif(path: Path, clip: Clip) -> None:
    path.write_bytes(_gif(clip))


def _write_html(path: Path, clip: Clip) -> None:
    data = base64.b64encode(_gif(clip)).decode()
    path.write_text(PAGE.format(caption=html.escape(clip.caption), data=data), encoding="utf-8")


def _write_mp4(path: Path, clip: Clip) -> None:
    """Write the frames without caption and phases."""
    import av

    odd = [(0, side % 2) for side in clip.frames.shape[1:3]]  # yuv420p halves both sides
    frames = np.pad(clip.frames, [(0, 0), *odd, (0, 0)], mode="edge")
    with av.open(str(path), "w", format="mp4") as video:
        stream = video.add_stream("h264", rate=Fraction(clip.fps).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        for frame in frames:
            video.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        video.mux(stream.encode())


WRITERS = {".gif": _write_gif, ".mp4": _write_mp4, ".html": _write_html}
"""Function that writes a clip to a path, by the suffix of the file."""
