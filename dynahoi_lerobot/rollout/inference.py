"""How long inference takes, and what the hand does meanwhile."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from math import ceil

from dynahoi_lerobot.foundation.conventions import CONTROL_DT

SYNC, ASYNC, RTC = "sync", "async", "rtc"
INFERENCE_MODES = {
    SYNC: "the world waits for every decision",
    ASYNC: "one inference at a time; the old chunk goes on meanwhile, and what is past of the new one is skipped",
    RTC: "as async, and the new chunk is guided by what the old one has committed to (real-time chunking)",
}
MAX_LATENCY_MS = 60_000.0
LABEL = re.compile(r"(?P<mode>\w+) (?:(?P<ms>[\d.e+]+) ms|measured)(?P<corrected>, corrected)?")
"""What `Inference.label` gives, with its parts."""
ROUNDING = 1e-9
"""Frames by which a latency may exceed a whole number of them, being computed in floating point."""


@dataclass(frozen=True)
class Inference:
    """Timing of a policy's inference.

    Attributes:
        mode: a key of ``INFERENCE_MODES``.
        latency_ms: time from an observation to the chunk that answers it [ms]; None is what each inference takes on
            this machine.
        corrected: whether the policy corrects its running chunk in every frame for what it sees meanwhile, which takes
            less than a frame (A2C2, arXiv 2509.23224).

    Raises:
        ValueError: if the mode is unknown, the latency out of range, or ``sync`` is given one, or a correction.
    """

    mode: str = SYNC
    latency_ms: float | None = 0.0
    corrected: bool = False

    def __post_init__(self) -> None:
        if self.mode not in INFERENCE_MODES:
            raise ValueError(f"there is no inference mode {self.mode!r}; known are {', '.join(INFERENCE_MODES)}")
        if self.latency_ms is not None and not 0 <= self.latency_ms <= MAX_LATENCY_MS:
            raise ValueError(f"the inference latency is {self.latency_ms} ms; it must be from 0 to {MAX_LATENCY_MS:g}")
        if self.mode == SYNC and self.latency_ms != 0:
            told = "measured" if self.latency_ms is None else f"{self.latency_ms} ms"
            raise ValueError(f"the inference latency is {told}, but with mode sync the world waits; use async or rtc")
        if self.mode == SYNC and self.corrected:
            raise ValueError("a correction is of chunks that take time, but with mode sync the world waits; use async")

    @property
    def label(self) -> str:
        """What a table calls it; empty for ``sync``."""
        if self.mode == SYNC:
            return ""
        latency = "measured" if self.latency_ms is None else f"{self.latency_ms:g} ms"
        return f"{self.mode} {latency}" + (", corrected" if self.corrected else "")

    @classmethod
    def from_label(cls, label: str) -> Inference:
        """Return the timing that has this ``label``.

        Raises:
            ValueError: if no timing has it.
        """
        if not label:
            return cls()
        found = LABEL.fullmatch(label)
        if not found:
            raise ValueError(f"no inference is called {label!r}; a name is such as 'async 150 ms'")
        return cls(found["mode"], float(found["ms"]) if found["ms"] else None, bool(found["corrected"]))


def frames_of(seconds: float) -> int:
    """Return the control steps [frames] until something that takes so long [s] is there: 150 ms are three."""
    return max(0, ceil(seconds / CONTROL_DT - ROUNDING)) if math.isfinite(seconds) else 0
