"""How a dataset stores its images: video through an encoder, or PNG files in the tables."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from dynahoi_lerobot.core.registry import Registry

CODECS: Registry[type[Codec]] = Registry("codec", "dynahoi_lerobot.dataset.codecs")


MAX_GOP = 10_000
X26X_PRESETS = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo",
)  # fmt: skip


@dataclass(frozen=True)
class Encoding:
    """How a dataset stores its camera.

    Attributes:
        codec: a registered name; ``images`` stores PNG files in the parquet tables instead of video.
        crf: constant rate factor, lower is better and larger; None takes the codec's own.
        preset: the encoder's speed setting; None takes the codec's own.
        gop: frames between key frames; every episode starts with one.
        fast_decode: leave out the filters that are slow to decode.
        pix_fmt: pixel format of the video.
    """

    codec: str = "h264"
    crf: int | None = None
    preset: str | None = None
    gop: int = 10
    fast_decode: bool = True
    pix_fmt: str = "yuv420p"

    def __post_init__(self) -> None:
        """Refuse what no encoder could do.

        Raises:
            UnknownNameError: if no such codec is registered.
            ValueError: if ``gop`` or ``crf`` is out of range, or the codec has no such preset.
        """
        codec = CODECS[self.codec]
        if not 1 <= self.gop <= MAX_GOP:
            raise ValueError(f"gop is {self.gop}; it must be 1 to {MAX_GOP} frames")
        if self.crf is not None and not 0 <= self.crf <= codec.max_crf:
            raise ValueError(f"crf is {self.crf}; for {self.codec} it must be 0 to {codec.max_crf}")
        if self.preset is not None and self.preset not in codec.presets:
            known = ", ".join(codec.presets) or "none"
            raise ValueError(f"preset is {self.preset!r}; {self.codec} has {known}")

    def make_codec(self) -> Codec:
        """Return the codec of that name with these settings."""
        return CODECS[self.codec](self)


class Codec(ABC):
    """Turns an Encoding into an encoder's options.

    Attributes:
        is_video: False if pictures go into the parquet tables.
        encoder: the encoder library's name in FFmpeg.
        canonical: the stream's codec name, as a reader sees it.
        crf: default rate factor.
        max_crf: largest rate factor of the encoder.
        preset: default speed setting.
        presets: all speed settings of the encoder.
    """

    is_video: ClassVar[bool] = True
    encoder: ClassVar[str]
    canonical: ClassVar[str]
    crf: ClassVar[int | None] = None
    max_crf: ClassVar[int] = 0
    preset: ClassVar[str | None] = None
    presets: ClassVar[tuple[str, ...]] = ()

    def __init__(self, encoding: Encoding) -> None:
        """Keep the user's settings."""
        self.encoding = encoding

    @property
    def chosen_crf(self) -> int | None:
        """The rate factor in force."""
        return self.crf if self.encoding.crf is None else self.encoding.crf

    @property
    def chosen_preset(self) -> str | None:
        """The speed setting in force."""
        return self.preset if self.encoding.preset is None else self.encoding.preset

    @abstractmethod
    def options(self) -> dict[str, str]:
        """Return FFmpeg options that give the same bytes on every run: one thread, no scene detection."""

    def info(self, image_size: int, fps: int) -> dict[str, Any]:
        """Return what LeRobot records about a video stream, so that its tools can re-encode it alike."""
        preset = self.chosen_preset
        return {
            "video.height": image_size,
            "video.width": image_size,
            "video.codec": self.canonical,
            "video.pix_fmt": self.encoding.pix_fmt,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
            "video.g": self.encoding.gop,
            "video.crf": self.chosen_crf,
            "video.preset": int(preset) if preset is not None and preset.isdigit() else preset,
            "video.fast_decode": int(self.encoding.fast_decode),
            "video.video_backend": "pyav",
            "video.extra_options": {},
            "is_depth_map": False,
        }


@CODECS.register("h264")
class H264(Codec):
    """x264 on one thread, without B-frames: packets are frames in order, so episodes can be cut out."""

    encoder = "libx264"
    canonical = "h264"
    crf = 20
    max_crf = 51
    preset = "superfast"
    presets = X26X_PRESETS

    def options(self) -> dict[str, str]:
        """Return the options; ``forced-idr`` makes each episode's first frame a place to seek to."""
        options = {
            "crf": str(self.chosen_crf),
            "preset": str(self.chosen_preset),
            "g": str(self.encoding.gop),
            "bf": "0",
            "forced-idr": "1",
            "x264-params": "scenecut=0:log-level=none",
        }
        return options | ({"tune": "fastdecode"} if self.encoding.fast_decode else {})


@CODECS.register("hevc")
class Hevc(Codec):
    """x265 on one thread, without B-frames."""

    encoder = "libx265"
    canonical = "hevc"
    crf = 24
    max_crf = 51
    preset = "superfast"
    presets = X26X_PRESETS

    def options(self) -> dict[str, str]:
        """Return the options; ``pools=none:frame-threads=1`` keeps x265 on one thread."""
        options = {
            "crf": str(self.chosen_crf),
            "preset": str(self.chosen_preset),
            "g": str(self.encoding.gop),
            "bf": "0",
            "forced-idr": "1",
            "x265-params": "pools=none:frame-threads=1:scenecut=0:log-level=none",
        }
        return options | ({"tune": "fastdecode"} if self.encoding.fast_decode else {})


# The library reports its settings on stderr unless told otherwise before its first use; 1 leaves errors.
os.environ.setdefault("SVT_LOG", "1")


@CODECS.register("libsvtav1")
class SvtAv1(Codec):
    """SVT-AV1 on one logical processor, in the low-delay structure whose packets are frames in order."""

    encoder = "libsvtav1"
    canonical = "av1"
    crf = 30
    max_crf = 63
    preset = "12"
    presets = tuple(str(number) for number in range(14))

    def options(self) -> dict[str, str]:
        """Return the options."""
        fast = int(self.encoding.fast_decode)
        return {
            "crf": str(self.chosen_crf),
            "preset": str(self.chosen_preset),
            "g": str(self.encoding.gop),
            "svtav1-params": f"lp=1:scd=0:pred-struct=1:fast-decode={fast}",
        }


@CODECS.register("images")
class Images(Codec):
    """No video: each frame is its own PNG file, embedded in its row."""

    is_video = False
    encoder = ""
    canonical = "png"

    def options(self) -> dict[str, str]:
        """Return nothing: there is no encoder to set."""
        return {}
