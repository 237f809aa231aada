"""Circle in a vertical plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.circle import CircularMotion


@MOTIONS.register("vertical_circle")
@dataclass(frozen=True)
class VerticalCircle(CircularMotion):
    """Constant angular speed about a horizontal axis."""

    name: ClassVar[str] = "vertical_circle"
    phrase: ClassVar[str] = "moving in a vertical circle"

    def axes(self) -> np.ndarray:
        """Return (2, 3): a horizontal unit vector and the vertical."""
        return np.array([[np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0], [0.0, 0.0, 1.0]])
