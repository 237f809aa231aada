"""Images on disk: mp4 files of many episodes through PyAV, or PNG files in the frame table.

Each episode is encoded on its own, from a new encoder, so its packets are a function of its images
and the settings alone: they are the same wherever in a file the episode lies, and a replay can
compare them byte by byte.
"""

import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
import av.logging
import numpy as np
from av.error import FFmpegError
from av.packet import Packet
from av.video.codeccontext import VideoCodecContext
from av.video.stream import VideoStream

from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.reading import regular
from dynahoi_lerobot.core.registry import known

# what FFmpeg prints wherever LeRobot has restored its own callback
av.logging.set_libav_level(av.logging.ERROR)

CODECS = {"h264": "libx264", "images": ""}
"""What stores images, and its encoder in FFmpeg: LeRobot's tools turn either into any other codec
that it knows."""
PRESETS = (
    "ultrafast",
    "superfast",
    "veryfast",
    "faster",
    "fast",
    "medium",
    "slow",
    "slower",
    "veryslow",
    "placebo",
)
MAX_GOP = 10_000
MAX_CRF = 51
MAX_PIXELS = 4096**2
FRAME = Fraction(1, CONTROL_HZ)
"""Duration of a frame [s], the unit of time in video files."""
READ_S = 1e-4
"""LeRobot finds the frame of a time that differs by less [s]."""


@dataclass(frozen=True)
class Encoding:
    """How a dataset stores its images."""

    codec: str = option(
        "h264", "h264, or images for PNG files in the parquet tables instead of video"
    )
    crf: int = option(20, "constant rate factor; lower means better quality and larger files")
    preset: str = option("superfast", "encoder speed preset")
    gop: int = option(2, "key frame interval [frames]; every episode starts with a key frame")

    def __post_init__(self) -> None:
        """Refuse what no encoder could do; ValueError naming the value and those allowed."""
        known("codec", self.codec, CODECS)
        known("preset", self.preset, dict.fromkeys(PRESETS))
        if not 1 <= self.gop <= MAX_GOP:
            raise ValueError(f"gop is {self.gop}; it must be 1 to {MAX_GOP} frames")
        if not 0 <= self.crf <= MAX_CRF:
            raise ValueError(f"crf is {self.crf}; it must be 0 to {MAX_CRF}")

    @property
    def is_video(self) -> bool:
        """Whether images are stored as video."""
        return self.codec != "images"

    def check_size(self, image_size: int) -> None:
        """Refuse images of an odd size [px], whose colors a video cannot halve; ValueError naming
        the size.
        """
        if self.is_video and image_size % 2:
            raise ValueError(
                f"the image size is {image_size} pixels; it must be an even number for a video"
            )

    def info(self, image_size: int) -> dict[str, Any]:
        """Return what LeRobot records about a video stream, so that its tools can re-encode it
        alike.
        """
        return {
            "video.height": image_size,
            "video.width": image_size,
            "video.codec": self.codec,
            "video.pix_fmt": "yuv420p",
            "video.fps": CONTROL_HZ,
            "video.channels": 3,
            "has_audio": False,
            "video.g": self.gop,
            "video.crf": self.crf,
            "video.preset": self.preset,
            "video.fast_decode": 1,
            "video.video_backend": "pyav",
            "video.extra_options": {},
            "is_depth_map": False,
        }

    def configure(self, encoder: VideoCodecContext, image_size: int) -> None:
        """Set up an encoder for square images of ``image_size`` pixels.

        One thread, no B-frames, so that packets are frames in order, and no filters to undo.
        """
        encoder.width = encoder.height = image_size
        encoder.pix_fmt = "yuv420p"
        encoder.thread_count = 1
        encoder.time_base = FRAME
        encoder.framerate = 1 / FRAME
        encoder.options = {
            "crf": str(self.crf),
            "preset": self.preset,
            "tune": "fastdecode",
            "g": str(self.gop),
            "bf": "0",
            "x264-params": "scenecut=0",
        }


def encode(images: np.ndarray, encoding: Encoding) -> list[Packet]:
    """Return the packets of one episode's square images (T, H, W, 3) uint8 RGB, one a frame, the
    first a key frame.
    """
    encoder = cast(VideoCodecContext, av.CodecContext.create(CODECS[encoding.codec], "w"))
    encoding.configure(encoder, images.shape[1])
    packets: list[Packet] = []
    for number, image in enumerate(images):
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        frame.pts = number
        frame.time_base = FRAME
        packets += encoder.encode(frame)
    return packets + encoder.encode(None)


class VideoFile:
    """An mp4 file that grows by episodes. Nothing in it tells when or by which library it was
    written.
    """

    def __init__(
        self, path: Path, encoding: Encoding, image_size: int, copied_from: Path | None = None
    ) -> None:
        """Open ``path`` for packets that ``encode`` returns of images of this size [px], or for
        those of the video ``copied_from``.
        """
        self.path = path
        self.frames = 0
        self.size_bytes = 0
        self._container = av.open(
            str(path), "w", options={"fflags": "+bitexact", "write_btrt": "0"}
        )
        if copied_from is None:
            stream = cast(
                VideoStream, self._container.add_stream(CODECS[encoding.codec], CONTROL_HZ)
            )
            encoding.configure(stream.codec_context, image_size)
        else:
            with av.open(str(regular(copied_from)), format="mp4") as source:
                template = source.streams.video[0]
                stream = self._container.add_stream_from_template(template, opaque=True)
        stream.time_base = FRAME
        self._stream = stream

    def append(self, packets: Iterable[Packet]) -> None:
        """Append the packets of one episode."""
        with self._writing():
            for packet in packets:
                packet.stream = self._stream
                packet.pts = packet.dts = self.frames
                packet.duration = 1
                packet.time_base = FRAME
                self.frames += 1
                self.size_bytes += packet.size
                self._container.mux(packet)

    def close(self) -> None:
        """Close the file and make sure that all of it reached the disk.

        Raises:
            OSError: if the file holds fewer frames than were written, as a full disk leaves it.
        """
        with self._writing():
            self._container.close()
        stored = sum(1 for _ in stored_packets(self.path))
        if stored != self.frames:
            raise OSError(
                errno.EIO, f"only {stored} of {self.frames} frames reached the disk", str(self.path)
            )

    def abandon(self) -> None:
        """Close the file, whatever it contains."""
        with suppress(FFmpegError):
            self._container.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Raise OSError in place of FFmpeg's own errors, which cannot travel between processes."""
        try:
            yield
        except FFmpegError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None


def stored_packets(path: Path) -> Iterator[Packet]:
    """Yield the packets of a video, one a frame; nothing is decoded.

    Raises:
        OSError: if the file cannot be read as a video.
    """
    with av.open(str(regular(path)), format="mp4") as container:
        # the last one only flushes
        yield from (packet for packet in container.demux(video=0) if packet.size)


def stream_problem(path: Path) -> str | None:
    """Say why other readers may show a video's packets at other times, turned, or not at all;
    nothing is decoded.
    """
    with av.open(str(regular(path)), format="mp4") as container:
        stream = container.streams.video[0]
        if len(container.streams) > 1:
            return f"has {len(container.streams)} streams, not one"
        rate = stream.average_rate
        if rate is None or abs(rate - CONTROL_HZ) > READ_S * CONTROL_HZ:
            return f"has {rate} frames/s, not {CONTROL_HZ}"
        times = sorted(
            cast(int, packet.pts) * packet.time_base
            for packet in container.demux(stream)
            if packet.size
        )
        late = (number for number, time in enumerate(times) if abs(time - number * FRAME) > READ_S)
        return next(
            (f"shows frame {number} at another time than its place" for number in late), None
        )


def decode(path: Path, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
    """Yield frames ``start`` to ``stop`` (excluded; None for all) of a video as (H, W, 3) uint8
    RGB.
    """
    with av.open(str(regular(path)), format="mp4") as container:
        stream = container.streams.video[0]
        if stream.width * stream.height > MAX_PIXELS:
            raise ValueError(
                f"its frames have {stream.width} x {stream.height} pixels, more than {MAX_PIXELS}"
            )
        rate = cast(Fraction, stream.average_rate)
        time_base = cast(Fraction, stream.time_base)
        if start:
            container.seek(int(start / rate / time_base), stream=stream)
        for frame in container.decode(stream):
            number = round(cast(int, frame.pts) * time_base * rate)
            if stop is not None and number >= stop:
                return
            if frame.rotation:
                raise ValueError(f"it is shown turned by {frame.rotation} degrees")
            if number >= start:
                yield frame.to_ndarray(format="rgb24")
