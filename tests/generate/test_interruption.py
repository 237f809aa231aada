"""Generation may end at any instant and in any way: what exists is whole, and the next run
completes it.
"""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.generate.pipeline import generate, open_workspace
from tests.generate.recorder import PLAN, record, record_slowly
from tests.generate.test_command import run

REPOSITORY = Path(__file__).parents[2]
WORDS = ("--episodes", 5, "--shard-episodes", 2)


def start(root: Path) -> int:
    """Generate in a child process; return its number."""
    child = os.fork()
    if child == 0:
        try:
            generate(PLAN, root, record=record_slowly)
        finally:
            os._exit(0)
    return child


def test_killed_at_random_instants(undisturbed, tmp_path):
    begin = time.monotonic()
    rng = random.Random(7)
    killed = 0
    root = tmp_path / "d"
    os.waitpid(start(tmp_path / "first"), 0)
    longest_s = time.monotonic() - begin
    shutil.rmtree(tmp_path / "first")
    while killed < 4:
        whole = {path: path.stat().st_ino for path in root.with_name("d.partial").glob("shard-*")}
        child = start(root)
        time.sleep(rng.uniform(0, longest_s))
        os.kill(child, signal.SIGKILL)
        killed += os.WIFSIGNALED(os.waitpid(child, 0)[1])
        if root.exists():
            assert hash_files(root) == undisturbed
            os.waitpid(start(root), 0)  # removes the workspace, where the kill came before that
            assert [path.name for path in tmp_path.iterdir()] == ["d"]
            shutil.rmtree(root)
        else:
            assert all(path.stat().st_ino == inode for path, inode in whole.items()), (
                "finished shards are kept"
            )
    generate(PLAN, root, record=record)
    assert hash_files(root) == undisturbed
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


SCRIPT = """
import sys
from tests.generate.test_command import run
from tests.generate.recorder import record_slowly
if __name__ == "__main__":
    shards = ["--episodes", 5, "--shard-episodes", 2, "--workers", 2]
    sys.exit(run(*shards, *sys.argv[1:], record=record_slowly))
"""


def test_two_workers_killed_with_their_parent(undisturbed, tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py"), "--root", str(tmp_path / "d")]
    environment = os.environ | {
        "PYTHONPATH": f"{REPOSITORY}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    }
    parent = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    workspace = tmp_path / "d.partial"
    wait_until(lambda: bool(list(workspace.glob("*shard-*"))))
    children = [
        int(n) for n in Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
    ]
    assert len(children) >= 2
    time.sleep(random.Random(3).uniform(0, 0.05))
    parent.kill()
    parent.wait()
    wait_until(lambda: not any(alive(child) for child in children))
    assert not (tmp_path / "d").exists()
    with pytest.raises(FileNotFoundError, match=r"repeat the command .* making it in .*d\.partial"):
        Store(tmp_path / "d")
    assert run("--root", tmp_path / "d", *WORDS) == 0
    assert hash_files(tmp_path / "d") == undisturbed


def wait_until(condition, timeout_s: float = 120.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split()[2] != "Z"
    except FileNotFoundError:
        return False


def test_two_processes_on_one_folder(undisturbed, tmp_path, capsys):
    with open_workspace(PLAN, tmp_path / "d"):
        assert run("--root", tmp_path / "d", *WORDS) == 1
    told = capsys.readouterr().err
    assert f"process {os.getpid()} on" in told
    assert told.count("\n") == 1
    assert run("--root", tmp_path / "d", *WORDS) == 0
    assert hash_files(tmp_path / "d") == undisturbed


@pytest.mark.parametrize("largest_bytes", [3_000, 20_000, 40_000])
def test_file_system_that_stops_writing(undisturbed, tmp_path, capsys, largest_bytes):
    """No file may grow beyond a limit: the mp4, the parquet and the JSON files fail in turn,
    FFmpeg's included.
    """
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, limits[1]))
    try:
        code = run("--root", tmp_path / "d", *WORDS)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert code == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "d").exists()
    assert run("--root", tmp_path / "d", *WORDS) == 0
    assert hash_files(tmp_path / "d") == undisturbed
