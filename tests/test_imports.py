"""How the core hangs together: rooms import in one direction only, and none brings in torch or LeRobot."""

from __future__ import annotations

import subprocess
import sys

from tests.rooms import PACKAGE, ROOMS, imports, room_of

PROGRAM = """
import importlib, pkgutil, sys
import dynahoi_lerobot
names = [m.name for m in pkgutil.walk_packages(dynahoi_lerobot.__path__, "dynahoi_lerobot.")]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
    heavy = sorted({"torch", "lerobot"} & set(sys.modules))
    if heavy:
        sys.exit(f"{name} imports {', '.join(heavy)}")
print(len(names))
"""


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
    assert folders == {room for room in ROOMS if room != "nouns" and not (PACKAGE / f"{room}.py").exists()}


def test_no_module_of_the_core_imports_torch_or_lerobot():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) > 100, "the walk must have found the core's modules"
