"""Registration: every kind of motion is a Gymnasium id."""

from __future__ import annotations

import gymnasium as gym

from dynahoi_lerobot.motions import MOTIONS


def register_envs() -> None:
    """Register ``dynahoi/<kind>-v0`` for every registered motion, and ``dynahoi/all-v0``; only once."""
    for kind in (None, *MOTIONS.names()):
        gym_id = f"dynahoi/{kind or 'all'}-v0"
        if gym_id not in gym.registry:
            gym.register(
                gym_id,
                entry_point="dynahoi_lerobot.env:DynahoiEnv",
                vector_entry_point="dynahoi_lerobot.env:DynahoiVectorEnv",
                kwargs={"kind": kind},
            )
