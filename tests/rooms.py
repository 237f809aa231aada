"""The rooms of the core, in the order in which they may import each other: each knows only those before it."""

from __future__ import annotations

ROOMS = (
    "foundation",
    "objects",
    "motions",
    "hands",
    "nouns",
    "metrics",
    "scene",
    "renderers",
    "captures",
    "experts",
    "world",
    "sampling",
    "rollout",
    "env",
    "dataset",
    "verify",
    "generate",
    "vlm",
    "evaluate",
    "adapters",
    "report",
    "cli",
)
"""``nouns`` are the modules beside the folders: episode, episode_spec, agent, appearance, features."""


def room_of(module: str) -> str:
    """Return the room of a dotted module of ``dynahoi_lerobot``."""
    first = module.split(".")[1]
    return first if first in ROOMS else "nouns"
