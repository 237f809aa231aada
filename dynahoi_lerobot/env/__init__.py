"""The Gymnasium environments ``DynahoiVectorEnv`` (native, N worlds) and ``DynahoiEnv`` (one).

Importing this package registers the ids ``dynahoi/all-v0`` and ``dynahoi/<kind>-v0`` for every
kind of motion. ``gym.make("dynahoi_lerobot.env:dynahoi/all-v0")`` imports it. Held-out kinds play
split ``ood_motion``, all others ``test``.
"""

import gymnasium as gym

from dynahoi_lerobot.env.vector_env import DynahoiEnv, DynahoiVectorEnv
from dynahoi_lerobot.motions import MOTIONS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

__all__ = ["DynahoiEnv", "DynahoiVectorEnv"]


for _kind in (None, *MOTIONS.names()):
    _split = "ood_motion" if _kind in BENCHMARK.splits["ood_motion"].motions else "test"
    gym.register(
        f"dynahoi/{_kind or 'all'}-v0",
        entry_point="dynahoi_lerobot.env:DynahoiEnv",
        vector_entry_point="dynahoi_lerobot.env:DynahoiVectorEnv",
        kwargs={"kind": _kind, "split": _split},
    )
