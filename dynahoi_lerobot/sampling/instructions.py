"""The instruction of an episode, which names the motion or does not."""

from __future__ import annotations

import numpy as np

INSTRUCTION_STYLES = ("reveal", "neutral", "mixed")
"""``reveal`` names object and motion, ``neutral`` the object only, ``mixed`` is either with equal probability."""
REVEALING = "Catch the {object} that is {phrase}."
NEUTRAL = "Catch the moving {object}."


def draw_instruction(style: str, object_name: str, phrase: str, rng: np.random.Generator) -> str:
    """Return an instruction.

    Args:
        style: one of ``INSTRUCTION_STYLES``.
        object_name: what is to be caught.
        phrase: the motion, as it continues "the object that is".
        rng: decides between the two where the style is ``mixed``.
    """
    reveals = rng.random() < 0.5 if style == "mixed" else style == "reveal"
    return (REVEALING if reveals else NEUTRAL).format(object=object_name, phrase=phrase)
