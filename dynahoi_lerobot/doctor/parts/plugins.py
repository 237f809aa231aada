"""Plugins: what adds motions and so on to the core, and what adds environments and policies to LeRobot."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib.metadata import distributions, entry_points
from pathlib import Path

from dynahoi_lerobot.doctor.parts.base import Fact, part
from dynahoi_lerobot.foundation.plugins import GROUP, import_plugin

LEROBOT_PREFIXES = ("lerobot_env_", "lerobot_policy_", "lerobot_robot_", "lerobot_teleoperator_", "lerobot_camera_")
"""How LeRobot finds distributions that extend it."""


@part("plugins")
def plugins(folder: Path) -> Iterator[Fact]:
    """Yield the distributions that LeRobot imports as plugins, and the modules that the core imports as such."""
    del folder
    found = {(dist.name, dist.version) for dist in distributions() if dist.name.startswith(LEROBOT_PREFIXES)}
    for name, version in sorted(found):
        yield Fact(name, version, "LeRobot finds it")
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value)):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            import_plugin(entry)
        yield Fact(
            f"plugin {entry.name}", entry.value, *[str(warning.message) for warning in told][:1], problem=bool(told)
        )
