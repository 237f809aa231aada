"""The bundled hand with an abducted thumb: fingers and thumb close around the target from opposite sides.

The thumb of the capsule hand comes from above, so that a target which the four fingers push sideways slips out under
it. With the thumb abducted, fingers, thumb and palm enclose the target.
"""

from __future__ import annotations

from typing import ClassVar

from dynahoi_lerobot.hands.base import HANDS
from dynahoi_lerobot.hands.capsule import HAND, CapsuleHand, Finger

THUMB = Finger(
    (-0.042, -0.03, 0.004), (0.0, -0.9798, 0.2), (0.0, 0.2, 0.9798), (0.044, 0.034, 0.026), 0.0095, (1.0, 1.4, 0.8)
)
"""Points away from the fingers and a little up, and flexes towards them."""


@HANDS.register("opposed")
class OpposedHand(CapsuleHand):
    """The capsule hand with an abducted thumb, for grasps that friction must hold."""

    fingers: ClassVar[dict[str, Finger]] = {**HAND, "thumb": THUMB}
