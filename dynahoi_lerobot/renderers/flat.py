"""The ray caster as MuJoCo's other renderers draw: one sample per pixel, no shadows, sharp textures, a headlight."""

from __future__ import annotations

from typing import ClassVar

from dynahoi_lerobot.renderers.base import RENDERERS
from dynahoi_lerobot.renderers.tiles import TileRenderer


@RENDERERS.register("flat")
class FlatRenderer(TileRenderer):
    """What ``warp`` draws, an order of magnitude faster, and highlights and one translucent layer.

    The reference that ties ``tiles`` to MuJoCo's renderers, and the control for what shadows and soft light are worth.
    """

    soft: ClassVar[bool] = False
