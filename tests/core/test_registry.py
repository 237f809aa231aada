"""Importing a package registers its modules; modules that installed distributions name as entry
points register by themselves.
"""

import importlib
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

from dynahoi_lerobot.core.agent import Agent
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions import MOTIONS, Motion
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from tests.tools import install, python

ROOMS = ("objects", "motions", "hands", "metrics", "experts")
"""Packages of the core that register."""
MOTION = '''
"""A motion of somebody else."""

from dataclasses import dataclass

from dynahoi_lerobot.motions import MOTIONS

assert "lob" in MOTIONS  # a plugin may look names up while it is imported


@MOTIONS.register("{name}")
@dataclass(frozen=True)
class Borrowed(MOTIONS["constant"]):
    """x = a: a straight line under another name."""
'''


def test_importing_a_package_registers_all_of_its_modules() -> None:
    packages = [f"dynahoi_lerobot.{room}" for room in ROOMS]
    imported = python("-c", f"import sys, {', '.join(packages)}; print(*sys.modules)").split()
    for package in packages:
        modules = pkgutil.iter_modules(importlib.import_module(package).__path__, package + ".")
        assert {module.name for module in modules} <= set(imported)


def test_a_plugin_is_listed_and_a_broken_one_is_named(tmp_path: Path) -> None:
    install(tmp_path, "sound", {"sound_motion": MOTION.format(name="glide")})
    install(
        tmp_path, "broken", {"broken_motion": "1 / 0", "greedy_motion": MOTION.format(name="lob")}
    )
    command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", "list", "motions", "--json"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    listed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    names = [row["name"] for row in json.loads(listed.stdout)]
    assert "glide" in names
    assert names.count("lob") == 1
    assert (
        "plugin 'broken_motion' of broken (broken_motion) could not be imported: ZeroDivision"
        in listed.stderr
    )
    assert "the plugin 'greedy_motion' of broken" in listed.stderr
    assert all(line.startswith("dynahoi list: ") for line in listed.stderr.splitlines())
    assert "the motion name 'lob' is taken" in listed.stderr


@pytest.mark.parametrize(
    ("registry", "entry", "message"),
    [
        (EXPERTS, type("Late", (Agent,), {}), "expert 'odd' must be of type Expert, got .*Late"),
        (OBJECTS, "ball", "object 'odd' must be of type ObjectType, got 'ball'"),
        (
            MOTIONS,
            type("Odd", (Motion,), {"category": "hybrid"}),
            "motion 'odd' must define phrase",
        ),
    ],
)
def test_an_entry_of_another_kind_is_refused_where_it_is_registered(registry, entry, message):
    with pytest.raises(ValueError, match=message):
        registry.register("odd")(entry)
    assert "odd" not in registry


def test_an_edit_in_any_module_of_a_plugins_package_changes_the_code_fingerprint(
    tmp_path: Path,
) -> None:
    def fingerprint() -> str:
        script = (
            "from dynahoi_lerobot.sampling.fingerprint import code_fingerprint; "
            "print(code_fingerprint())"
        )
        return python("-c", script, PYTHONPATH=str(tmp_path)).strip()

    (tmp_path / "borrowed").mkdir()
    (tmp_path / "borrowed/speeds.py").write_text("FAST = 1.0")
    install(tmp_path, "sound", {"borrowed/__init__": MOTION.format(name="glide")})
    entries = tmp_path / "sound-1.0.dist-info/entry_points.txt"
    entries.write_text("[dynahoi_lerobot.plugins]\nglide = borrowed\n")
    installed = fingerprint()
    (tmp_path / "borrowed/speeds.py").write_text("FAST = 2.0")
    assert len({code_fingerprint(), installed, fingerprint()}) == 3
