"""S_hold: success of the physical capture."""

from __future__ import annotations

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.metrics.base import FRACTION, metric


@metric("S_hold", unit=FRACTION, direction="higher", aggregation="rate", condition="capture rule contact")
def s_hold(episode: Episode) -> bool | None:
    """Physical capture: the hand holds the free target off every other surface for 0.5 s.

    ``S_hold = 1 if the capture rule contact reports success, else 0``; None under the capture rule attach, where the
    target is welded to the palm and cannot slip.

    Fraction of episodes under contact, higher is better. Ours.
    """
    return episode.success if episode.meta.capture == "contact" else None
