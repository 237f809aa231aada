"""The boxes of an mp4 file (ISO/IEC 14496-12): they tile it from first byte to last, and are the muxer's own."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import av

BOXES = ("ftyp", "free", "mdat", "moov")
"""What FFmpeg writes, in its order."""
HEADER = struct.Struct(">I4s")
LARGE = struct.Struct(">Q")
"""A size of 1 says that the true one follows the header."""


def container_problems(path: Path) -> Iterator[str]:
    """Yield what the file holds besides one video stream's packets and their index."""
    size, boxes = path.stat().st_size, list(_boxes(path))
    end = boxes[-1][1] + boxes[-1][2] if boxes else 0
    names = [name for name, _, _ in boxes]
    if end != size or tuple(names) != BOXES:
        yield f"has {size} bytes, of which the boxes {', '.join(names) or 'none'} take {end}"
        return
    with av.open(str(path)) as container:
        if len(container.streams) != 1:
            yield f"holds {len(container.streams)} streams; there is one"
        media = sum(packet.size for packet in container.demux())
    (held,) = (length for name, _, length in boxes if name == "mdat")
    if not 0 <= held - media <= LARGE.size + HEADER.size:
        yield f"has {held} bytes of media data, its packets {media}"


def _boxes(path: Path) -> Iterator[tuple[str, int, int]]:
    """Yield (name, offset, length) of every box of the file, as far as they can be read."""
    size = path.stat().st_size
    with path.open("rb") as file:
        offset = 0
        while offset + HEADER.size <= size:
            file.seek(offset)
            length, name = HEADER.unpack(file.read(HEADER.size))
            if length == 1:
                (length,) = LARGE.unpack(file.read(LARGE.size).ljust(LARGE.size, b"\0"))
            if length < HEADER.size or offset + length > size:
                return
            yield name.decode("latin-1"), offset, length
            offset += length
