"""Which seeds a generated dataset draws: one per slot, and others in its place where the expert fails."""

from __future__ import annotations

import math

REDRAW_STRIDE = math.lcm(*range(1, 25))
"""A slot whose seed fails is drawn again with ``seed + k * REDRAW_STRIDE``, k = 1, 2, ...

Recipes choose the kind of motion by the seed modulo the number of kinds; a multiple of every number up to 24 keeps the
slot's kind, so failures do not unbalance the dataset.
"""

MAX_DRAWS = 16
"""Draws per slot before the recipe is called impossible."""
