from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import importlib, pkgutil, sys
import dynahoi_lerobot.dataset as room
names = [m.name for m in pkgutil.walk_packages(room.__path__, room.__name__ + ".")]
for name in names:
    importlib.import_module(name)
    heavy = sorted({"mujoco", "mujoco_warp", "warp", "torch", "lerobot", "datasets", "pandas"} & set(sys.modules))
    if heavy:
        sys.exit(f"{name} imports {', '.join(heavy)}")
print(len(names))
"""


def test_no_module_of_the_dataset_room_imports_a_simulator_torch_or_lerobot():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 8, "the walk must have found the modules"
