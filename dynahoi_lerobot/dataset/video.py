"""One mp4 file of many episodes, written through PyAV; the same frames give the same bytes."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import av.logging
import numpy as np
from av.video.frame import PictureType
from av.video.stream import VideoStream

from dynahoi_lerobot.dataset.codecs import Encoding


class VideoWriter:
    """Appends episodes to one mp4 file; every episode begins with a key frame.

    ``bitexact`` keeps dates and library versions out of the container, and each encoder runs on one thread.
    """

    def __init__(self, path: Path, image_size: int, fps: int, encoding: Encoding) -> None:
        """Open ``path`` for square frames of ``image_size`` pixels at ``fps`` Hz."""
        self.path = path
        self.frames = 0
        self.size_bytes = 0
        self._time_base = Fraction(1, fps)
        self._container = av.open(str(path), "w", options={"fflags": "+bitexact"})
        options = encoding.make_codec().options()
        self._stream = cast(
            VideoStream, self._container.add_stream(encoding.make_codec().encoder, fps, options=options)
        )
        self._stream.width = self._stream.height = image_size
        self._stream.pix_fmt = encoding.pix_fmt
        self._stream.thread_count = 1
        self._stream.time_base = self._time_base

    def write(self, images: np.ndarray) -> None:
        """Append one episode.

        Args:
            images: (T, H, W, 3) uint8 RGB.
        """
        for number, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = self.frames, self._time_base
            if number == 0:
                frame.pict_type = PictureType.I
            self._mux(frame)
            self.frames += 1

    def close(self) -> None:
        """Flush the encoder, close the file and make sure that all of it reached the disk.

        Raises:
            OSError: if the file holds fewer frames than were written, as a full disk leaves it.
        """
        self._mux(None)
        self._container.close()
        if (stored := count_frames(self.path)) != self.frames:
            raise OSError(errno.EIO, f"only {stored} of {self.frames} frames reached the disk", str(self.path))

    def abandon(self) -> None:
        """Close the file, whatever it contains."""
        self._container.close()

    def _mux(self, frame: av.VideoFrame | None) -> None:
        for packet in self._stream.encode(frame):
            self.size_bytes += packet.size
            self._container.mux(packet)


def count_frames(path: Path) -> int:
    """Return the number of frames of a video by its packets; nothing is decoded.

    Raises:
        OSError: if the file cannot be read as a video.
    """
    with av.open(str(path)) as container:
        sizes = [packet.size for packet in container.demux(video=0)]
    return sum(size > 0 for size in sizes)  # the last packet is empty, it flushes


def decode(path: Path, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
    """Yield frames ``start`` to ``stop`` (excluded; None for all) of a video as (H, W, 3) uint8 RGB."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        rate = cast(Fraction, stream.average_rate)
        time_base = cast(Fraction, stream.time_base)
        if start:
            container.seek(int(start / rate / time_base), stream=stream)
        for frame in container.decode(stream):
            number = round(cast(int, frame.pts) * time_base * rate)
            if stop is not None and number >= stop:
                return
            if number >= start:
                yield frame.to_ndarray(format="rgb24")
