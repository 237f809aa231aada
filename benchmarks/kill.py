"""``dynahoi generate`` killed at random instants: what is left running, and whether the same command finishes the job.

python benchmarks/kill.py [--kills 30] [--episodes 12] [--image-size 0] [--json FILE] [--tiny]

The ways to generate (one process, two, datatrove's tasks on this machine) and the signals take turns.
Each is killed once at an instant drawn from the time that an undisturbed run takes, and its processes are counted two
seconds later. Then the same command is run to its end; the dataset must be that of an undisturbed run, byte by byte.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from itertools import cycle, islice, product
from pathlib import Path

from support.options import benchmark_parser, write_numbers

from dynahoi_lerobot.dataset.manifest import Manifest, hash_files

TINY = {"kills": 2, "episodes": 2}
WAYS = {
    "workers 1": ["--workers", "1"],
    "workers 2": ["--workers", "2"],
    "executor local": ["--executor", "local", "--workers", "2"],
}
SIGNALS = (signal.SIGKILL, signal.SIGTERM)
ORPHANS_S = 2.0
"""Processes that still run so long after the kill are orphans."""
MARK = "DYNAHOI_KILL_BENCHMARK"
"""Environment variable by which the processes of a run are found, whoever their parent is by then."""


@dataclass
class Line:
    """One row of the table: what happened under one way to generate and one signal."""

    way: str
    signal: str
    kills: int = 0
    recovered: int = 0
    orphans: int = 0
    ended_before: int = 0
    killed_after_s: list[float] = field(default_factory=list)
    finished_in_s: list[float] = field(default_factory=list)


def main() -> None:
    parser = benchmark_parser(__doc__, **TINY)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--episodes", type=int, default=12)
    parser.add_argument("--image-size", type=int, default=0, help="0 for no pictures")
    parser.add_argument("--seed", type=int, default=0, help="of the instants")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lines = measure(args, Path(folder))
    show(lines)
    write_numbers(args, lines=[asdict(line) for line in lines])
    if any(line.recovered < line.kills or line.orphans for line in lines):
        sys.exit("a killed run left processes, or could not be finished")


def measure(args: argparse.Namespace, folder: Path) -> list[Line]:
    """Kill one run after another; return the lines of the ways that took part."""
    rng, lines, lasting = random.Random(args.seed), {}, {}
    expected = None
    for number, (way, ending) in enumerate(islice(cycle(product(WAYS, SIGNALS)), args.kills)):
        if way not in lasting:
            lasting[way], files = undisturbed(args, way, folder / "undisturbed")
            expected = expected or files
            assert files == expected, "the same bytes, whichever way they are made"
        line = lines.setdefault((way, ending), Line(way, ending.name))
        root = folder / f"run-{number}"
        kill_once(args, line, root, rng.uniform(0, lasting[way]), ending)
        finish(args, line, root, expected)
        print(f"{number + 1}/{args.kills} {way}, {ending.name} after {line.killed_after_s[-1]:.2f} s", flush=True)
    return list(lines.values())


def undisturbed(args: argparse.Namespace, way: str, root: Path) -> tuple[float, dict[str, str]]:
    """Return how long a run takes [s], and the hashes of its files."""
    begin = time.monotonic()
    start(args, way, root).wait()
    seconds, files = time.monotonic() - begin, hash_files(root)
    shutil.rmtree(root)
    return seconds, files


def start(args: argparse.Namespace, way: str, root: Path) -> subprocess.Popen[bytes]:
    """Start ``dynahoi generate``; all its processes carry the mark."""
    words = ["--root", str(root), "--episodes", str(args.episodes), "--image-size", str(args.image_size)]
    command = [
        sys.executable,
        "-m",
        "dynahoi_lerobot.cli.main",
        "generate",
        *words,
        "--shard-episodes",
        "2",
        *WAYS[way],
    ]
    environment = os.environ | {MARK: str(root)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def kill_once(args: argparse.Namespace, line: Line, root: Path, after_s: float, ending: signal.Signals) -> None:
    """Generate, kill the parent process at an instant, and count what runs two seconds later; end that, too."""
    process = start(args, line.way, root)
    time.sleep(after_s)
    line.ended_before += process.poll() is not None
    process.send_signal(ending)
    process.wait()
    time.sleep(ORPHANS_S)
    orphans = marked(root)
    for orphan in orphans:
        os.kill(orphan, signal.SIGKILL)
    line.kills += 1
    line.orphans += len(orphans)
    line.killed_after_s.append(after_s)


def finish(args: argparse.Namespace, line: Line, root: Path, expected: dict[str, str] | None) -> None:
    """Run the same command to its end; count it if the dataset is the expected one and nothing else is left."""
    begin = time.monotonic()
    code = start(args, line.way, root).wait()
    line.finished_in_s.append(time.monotonic() - begin)
    left = [path for path in root.parent.iterdir() if path != root]
    line.recovered += code == 0 and not left and hash_files(root) == Manifest.read(root).files == expected
    shutil.rmtree(root, ignore_errors=True)
    for path in left:
        shutil.rmtree(path, ignore_errors=True)


def marked(root: Path) -> list[int]:
    """Return the running processes, of any parent, that carry the mark of ``root``."""
    mark = f"{MARK}={root}\0".encode()
    return [int(path.name) for path in Path("/proc").glob("[0-9]*") if mark in _environment(path)]


def _environment(process: Path) -> bytes:
    """Return the variables with which a process was started; none if it has ended or is somebody else's."""
    try:
        return (process / "environ").read_bytes()
    except OSError:
        return b""


def show(lines: list[Line]) -> None:
    print(
        f"\n{'way':16} {'signal':8} {'kills':>5} {'recovered':>9} {'orphans':>7} {'too late':>8} {'finished in s':>14}"
    )
    for line in lines:
        mean_s = sum(line.finished_in_s) / len(line.finished_in_s)
        counts = f"{line.kills:5} {line.recovered:9} {line.orphans:7} {line.ended_before:8}"
        print(f"{line.way:16} {line.signal:8} {counts} {mean_s:14.1f}")


if __name__ == "__main__":
    main()
