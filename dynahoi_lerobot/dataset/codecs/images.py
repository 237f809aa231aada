"""Lossless PNG pictures inside the parquet tables."""

from __future__ import annotations

from dynahoi_lerobot.dataset.codecs.base import CODECS, Codec


@CODECS.register("images")
class Images(Codec):
    """No video: each frame is its own PNG file, embedded in its row."""

    is_video = False
    encoder = ""
    canonical = "png"

    def options(self) -> dict[str, str]:
        """Return nothing: there is no encoder to set."""
        return {}
