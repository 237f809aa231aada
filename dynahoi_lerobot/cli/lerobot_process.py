"""One of LeRobot's commands, unchanged, in a process of its own: its output goes to a file, its progress to a bar."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tqdm import tqdm

ONE_THREAD = {"OMP_NUM_THREADS": "1"}
"""One compute thread beside those that decode: more fight over two cores and take several times as long."""


def run_lerobot(script: str, words: list[str], log: Path, step: str, bar: tqdm) -> int:
    """Run one of LeRobot's scripts; return its exit code.

    Args:
        script: module of ``lerobot.scripts``.
        words: its arguments.
        log: file that receives everything it prints.
        step: what a line of it begins with whenever a step is done.
        bar: advances by one at every such line.
    """
    command = [sys.executable, "-m", f"lerobot.scripts.{script}", *words]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, **ONE_THREAD},
        encoding="utf-8",
        errors="replace",
    )
    assert process.stdout is not None
    with process, log.open("w", encoding="utf-8") as file:
        for line in process.stdout:
            file.write(line)
            bar.update(line.startswith(step))
    return process.returncode
