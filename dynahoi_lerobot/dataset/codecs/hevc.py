"""H.265 through x265: smaller files than H.264, several times slower to write."""

from __future__ import annotations

from dynahoi_lerobot.dataset.codecs.base import CODECS, X26X_PRESETS, Codec


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
