"""The Gymnasium environments ``DynahoiVectorEnv`` (native, N worlds) and ``DynahoiEnv`` (one)."""

import gymnasium as gym

from dynahoi_lerobot.env.vector_env import DynahoiEnv, DynahoiVectorEnv
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

__all__ = ["DynahoiEnv", "DynahoiVectorEnv", "register_envs"]


def register_envs() -> None:
    """Register ``dynahoi/<kind>-v0`` for every registered motion, and ``dynahoi/all-v0``; only
    once.

    Held-out kinds play split ``ood_motion``, all others ``test``.
    """
    held_out = BENCHMARK.splits["ood_motion"].motions
    for kind in (None, *MOTIONS.names()):
        gym_id = f"dynahoi/{kind or 'all'}-v0"
        if gym_id not in gym.registry:
            gym.register(
                gym_id,
                entry_point="dynahoi_lerobot.env:DynahoiEnv",
                vector_entry_point="dynahoi_lerobot.env:DynahoiVectorEnv",
                kwargs={"kind": kind, "split": "ood_motion" if kind in held_out else "test"},
            )
