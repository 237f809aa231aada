"""H.264 through x264: fast to write, fast to read, decoded everywhere."""

from __future__ import annotations

from dynahoi_lerobot.dataset.codecs.base import CODECS, X26X_PRESETS, Codec


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
