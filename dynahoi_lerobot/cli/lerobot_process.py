"""Run a LeRobot command in a subprocess, with its output in a log file and its progress in a bar."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tqdm import tqdm

ONE_THREAD = {"OMP_NUM_THREADS": "1"}
"""One compute thread beside those that decode; more of them contend for two cores and slow each other down."""


def run_lerobot(script: str, words: list[str], log: Path, step: str, bar: tqdm) -> int:
    """Run one of LeRobot's scripts; return its exit code.

    Args:
        script: module of ``lerobot.scripts``.
        words: its arguments.
        log: file that receives everything it prints.
        step: what it prints after every step.
        bar: advances by one at each line with that.
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
            bar.update(step in line)
    return process.returncode
