"""Registration: every kind of motion is a Gymnasium id."""

from __future__ import annotations

import gymnasium as gym

from dynahoi_lerobot.motions import MOTIONS, benchmark_motions


def register_envs() -> None:
    """Register ``dynahoi/<kind>-v0`` for every kind of motion, and ``dynahoi/all-v0``; once, however often called."""
    for kind in (None, *benchmark_motions(), *(name for name, motion in MOTIONS.items() if motion.held_out)):
        gym_id = f"dynahoi/{kind or 'all'}-v0"
        if gym_id not in gym.registry:
            gym.register(
                gym_id,
                entry_point="dynahoi_lerobot.env:DynahoiEnv",
                vector_entry_point="dynahoi_lerobot.env:DynahoiVectorEnv",
                kwargs={"kind": kind},
            )
