"""The core stands alone: importing any of its modules brings in neither torch nor LeRobot."""

from __future__ import annotations

import subprocess
import sys

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


def test_no_module_of_the_core_imports_torch_or_lerobot():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) > 100, "the walk must have found the core's modules"
