"""Starts generation again and again and kills it with SIGKILL at random instants; run as a script.

Children are forked from a process that has imported everything, so a start costs milliseconds.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sys
import time
from pathlib import Path

from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from tests.generate.recorder import FakeRecipe, record_slowly

PLAN = GenerationPlan(FakeRecipe(), 5, shard_episodes=2)


def start(root: Path) -> int:
    """Generate in a child; return its process number."""
    child = os.fork()
    if child == 0:
        try:
            generate(PLAN, root, record=record_slowly)
        finally:
            os._exit(0)
    return child


def run_for(seconds: float, root: Path) -> bool:
    """Generate in a child; kill it after so long. Return True if it was killed."""
    child = start(root)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def undisturbed_s(root: Path) -> float:
    """Return how long an undisturbed run takes [s], once everything that is imported late is there."""
    generate(PLAN, root, record=record_slowly)
    shutil.rmtree(root)
    begin = time.monotonic()
    os.waitpid(start(root), 0)
    shutil.rmtree(root)
    return time.monotonic() - begin


def inodes(root: Path) -> dict[str, int]:
    return {path.name: path.stat().st_ino for path in root.with_name(f"{root.name}.partial").glob("shard-*")}


def main(folder: Path, kills: int) -> dict[str, object]:
    rng, killed, finished, redone = random.Random(0), 0, [], 0
    longest_s = undisturbed_s(folder / "first")
    while killed < kills:
        root = folder / f"d{len(finished)}"
        while not root.exists():
            before = inodes(root)
            killed += run_for(rng.uniform(0, longest_s), root)
            after = inodes(root) if not root.exists() else before
            redone += sum(after.get(name) != inode for name, inode in before.items())
        manifest = Manifest.read(root)  # whatever exists is whole
        os.waitpid(start(root), 0)
        leftovers = [path.name for path in folder.iterdir() if path != root]
        finished.append({"files": hash_files(root), "promised": manifest.files, "leftovers": leftovers})
        shutil.rmtree(root)
    return {"killed": killed, "redone": redone, "finished": finished}


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), int(sys.argv[2]))))
