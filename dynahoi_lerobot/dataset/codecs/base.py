"""The codec contract and the settings a user may choose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from dynahoi_lerobot.foundation.registry import Registry

CODECS: Registry[type[Codec]] = Registry("codec", "dynahoi_lerobot.dataset.codecs")


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
            ValueError: if ``gop`` is not positive or ``crf`` is negative.
        """
        CODECS[self.codec]
        if self.gop < 1:
            raise ValueError(f"gop is {self.gop}; it must be 1 frame or more")
        if self.crf is not None and self.crf < 0:
            raise ValueError(f"crf is {self.crf}; it must be 0 or more")

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
        preset: default speed setting.
    """

    is_video: ClassVar[bool] = True
    encoder: ClassVar[str]
    canonical: ClassVar[str]
    crf: ClassVar[int | None] = None
    preset: ClassVar[str | None] = None

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
