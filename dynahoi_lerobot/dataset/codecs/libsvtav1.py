"""AV1 through SVT-AV1: LeRobot's own default."""

from __future__ import annotations

import os

from dynahoi_lerobot.dataset.codecs.base import CODECS, Codec

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
