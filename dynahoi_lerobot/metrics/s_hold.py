"""S_hold: the physical capture."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric


@metric("S_hold", unit=FRACTION, direction="higher", kind="rate", condition="capture rule contact")
def s_hold(episode: Episode) -> bool | None:
    """Physical success: the hand holds the free target off every other surface for 0.5 s.

    Ours, for the capture rule contact: the paper attaches the target to the palm, so nothing can slip there.
    """
    return episode.success if episode.meta.capture == "contact" else None
