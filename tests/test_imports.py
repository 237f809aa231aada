"""How the core hangs together: rooms import in one direction only, and none brings in torch or LeRobot."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.rooms import PACKAGE, ROOMS, imports, room_of

PROGRAM = """
import importlib, pkgutil, sys
package, *heavy = sys.argv[1:]
names = [m.name for m in pkgutil.walk_packages(importlib.import_module(package).__path__, package + ".")]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
    if found := {*heavy} & set(sys.modules):
        sys.exit(f"{name} imports {', '.join(sorted(found))}")
print(len(names))
"""
HEAVY = {
    "dynahoi_lerobot": ("torch", "lerobot"),
    "dynahoi_lerobot.dataset": ("mujoco", "mujoco_warp", "warp", "torch", "lerobot", "datasets", "pandas"),
}
"""What no module of a package may import."""


def test_rooms_import_only_rooms_before_them():
    wrong = [
        f"{module} imports {imported}"
        for module, imported in imports()
        if module != "dynahoi_lerobot"
        and imported.startswith("dynahoi_lerobot.")
        and ROOMS.index(room_of(imported)) > ROOMS.index(room_of(module))
    ]
    assert not wrong, "\n".join(wrong)


def test_every_folder_is_a_room():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    modules = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert folders | modules == set(ROOMS)


@pytest.mark.parametrize(("package", "least"), [("dynahoi_lerobot", 100), ("dynahoi_lerobot.dataset", 8)])
def test_no_module_imports_what_is_heavy(package: str, least: int):
    command = [sys.executable, "-c", PROGRAM, package, *HEAVY[package]]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) > least, "the walk must have found the modules"
