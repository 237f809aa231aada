"""The GIFs of result folders, embedded in the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynahoi_lerobot.report.entries import Entry

MOST_CLIPS = 12
"""Clips shown per folder, the first by name; more would make the page too large."""

LARGEST_CLIP_BYTES = 20_000_000
GIF_HEADERS = (b"GIF87a", b"GIF89a")


@dataclass(frozen=True)
class Clips:
    """The clips of one entry: names with ``data:`` URLs, and the number left out."""

    label: str
    clips: tuple[tuple[str, str], ...]
    left_out: int


def find_clips(entries: Sequence[Entry]) -> list[Clips]:
    """Return the clips of every entry that has any."""
    found = [_clips_of(entry) for entry in entries]
    return [clips for clips in found if clips.clips]


def _clips_of(entry: Entry) -> Clips:
    paths = [path for path in sorted(entry.results.folder.glob("*.gif")) if _is_gif(path)]
    shown = tuple((path.stem, _data_uri(path.read_bytes())) for path in paths[:MOST_CLIPS])
    return Clips(entry.label, shown, len(paths) - len(shown))


def _is_gif(path: Path) -> bool:
    """Return whether this is a regular GIF of reasonable size; a link could embed any file."""
    if path.is_symlink() or not path.is_file() or path.stat().st_size > LARGEST_CLIP_BYTES:
        return False
    with path.open("rb") as file:
        return file.read(len(GIF_HEADERS[0])) in GIF_HEADERS


def _data_uri(gif: bytes) -> str:
    return "data:image/gif;base64," + base64.b64encode(gif).decode()
