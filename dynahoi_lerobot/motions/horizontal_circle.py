"""Circle in a horizontal plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynahoi_lerobot.motions.base import MOTIONS
from dynahoi_lerobot.motions.circle import CircularMotion


@MOTIONS.register("horizontal_circle")
@dataclass(frozen=True)
class HorizontalCircle(CircularMotion):
    """Constant angular speed about the vertical."""

    name: ClassVar[str] = "horizontal_circle"
    phrase: ClassVar[str] = "moving in a horizontal circle"
