"""An mp4 file made of other files' packets, without decoding."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
from av.packet import Packet
from av.video.stream import VideoStream

from dynahoi_lerobot.foundation.conventions import CONTROL_HZ


class VideoCopy:
    """Appends frames of files of one encoding.

    An episode begins with a key frame and no codec here reorders frames, so its packets stand alone.
    """

    def __init__(self, target: Path) -> None:
        """Open ``target`` for writing."""
        self._output = av.open(str(target), "w", options={"fflags": "+bitexact"})
        self._stream: VideoStream | None = None
        self._written = 0

    def open(self, source: Path) -> None:
        """Take frames from ``source`` from now on, from its first one.

        Raises:
            OSError: if it cannot be read as a video.
        """
        self._source, self._read = source, 0
        stream = (container := av.open(str(source))).streams.video[0]
        self._packets: Iterator[Packet] = (packet for packet in container.demux(stream) if packet.size)
        if self._stream is None:
            self._stream = cast(VideoStream, self._output.add_stream_from_template(stream, opaque=True))
            self._stream.time_base = Fraction(1, CONTROL_HZ)

    def frames(self, start: int, count: int) -> tuple[int, int]:
        """Copy ``count`` frames from the source's frame ``start`` on; return where they begin and end here.

        Raises:
            ValueError: if the source is shorter than that.
        """
        begin = self._written
        for packet in itertools.islice(self._packets, start - self._read, start - self._read + count):
            packet.stream = cast(VideoStream, self._stream)
            packet.time_base = Fraction(1, CONTROL_HZ)
            packet.pts = packet.dts = self._written
            packet.duration = 1
            self._output.mux(packet)
            self._written += 1
        if self._written - begin < count:
            raise ValueError(f"{self._source} ends before frame {start + count}")
        self._read = start + count
        return begin, self._written

    def close(self) -> None:
        """Finish the file."""
        self._output.close()
