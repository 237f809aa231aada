from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from dynahoi_lerobot.dataset.files import link, temporary_sibling
from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from tests.generate.recorder import FakeRecipe, record
from tests.generate.test_command import run

REPOSITORY = Path(__file__).parents[2]
PLAN = GenerationPlan(FakeRecipe(), 5, shard_episodes=2)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("undisturbed") / "d"
    generate(PLAN, root, record=record)
    return hash_files(root)


@pytest.mark.slow
def test_killed_at_twenty_random_instants(undisturbed, tmp_path):
    command = [sys.executable, "-m", "tests.generate.killer", str(tmp_path), "20"]
    output = subprocess.run(command, check=True, cwd=REPOSITORY, capture_output=True, timeout=120).stdout
    result = json.loads(output)
    assert result["killed"] >= 20
    assert result["redone"] == 0, "finished shards are kept"
    for finished in result["finished"]:
        assert finished["files"] == finished["promised"] == undisturbed
        assert finished["leftovers"] == []


SCRIPT = """
import sys
from tests.generate.test_command import run
from tests.generate.recorder import record_slowly
if __name__ == "__main__":
    run("--episodes", 4000, "--shard-episodes", 2, *sys.argv[1:], record=record_slowly)
"""


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("words", [("--workers", "2"), ("--executor", "local", "--tasks", "2", "--workers", "2")])
def test_workers_end_with_their_parent(tmp_path, words, ending):
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, str(tmp_path / "script.py"), "--root", str(tmp_path / "d"), *words]
    parent = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    wait_until(lambda: len(list((tmp_path / "d.partial").glob("shard-*"))) > 2)
    children = children_of(parent.pid)
    assert len(children) >= 2
    parent.send_signal(ending)
    parent.wait()
    try:
        wait_until(lambda: not any(alive(child) for child in children), timeout_s=2)
    finally:
        for child in filter(alive, children):
            os.kill(child, signal.SIGKILL)
    assert not (tmp_path / "d").exists()


def wait_until(condition, timeout_s: float = 30.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


def children_of(parent: int) -> list[int]:
    task = Path(f"/proc/{parent}/task/{parent}/children")
    return [int(child) for child in task.read_text().split()]


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split()[2] != "Z"
    except FileNotFoundError:
        return False


@contextmanager
def as_ordinary_user():
    """Root may write anywhere; for a while be somebody who may not."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


def test_read_only_folder(tmp_path, capsys):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    for parent in (tmp_path, *tmp_path.parents[:2]):
        parent.chmod(0o755)
    with as_ordinary_user():
        assert run("--root", folder / "d", "--episodes", 2) == 1
    assert "Permission denied" in capsys.readouterr().err
    assert not any(folder.iterdir())


@pytest.mark.parametrize("largest_bytes", [3_000, 20_000, 40_000])
def test_file_system_that_stops_writing(undisturbed, tmp_path, capsys, largest_bytes):
    """No file may grow beyond a limit: the mp4, the parquet and the JSON files fail in turn, FFmpeg's included."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, limits[1]))
    try:
        code = run("--root", tmp_path / "d", "--shard-episodes", 2, "--episodes", 5)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert code == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "d").exists()
    assert run("--root", tmp_path / "d", "--shard-episodes", 2, "--episodes", 5) == 0
    assert hash_files(tmp_path / "d") == undisturbed


def test_video_cut_short_by_a_full_disk_is_noticed(tmp_path, monkeypatch):
    from dynahoi_lerobot.dataset import video
    from tests.dataset.episodes import write

    monkeypatch.setattr(video, "count_frames", lambda path: 7)
    with pytest.raises(OSError, match=r"only 7 of 41 frames reached the disk"):
        write(tmp_path / "d", range(2))


def test_folders_appear_whole_or_not_at_all(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    (tmp_path / f".d.{socket.gethostname()}.{ended.pid}.0123abcd.tmp").mkdir()

    def fail() -> None:
        with temporary_sibling(tmp_path / "d") as folder:
            folder.mkdir()
            (folder / "half").touch()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert not any(tmp_path.iterdir()), "nothing is left, not even what an earlier process left"
    with temporary_sibling(tmp_path / "d") as folder:
        folder.mkdir()
        (folder / "whole").touch()
        assert not (tmp_path / "d").exists()
    assert [path.name for path in tmp_path.rglob("*")] == ["d", "whole"]


def test_the_first_of_two_processes_wins(tmp_path):
    with temporary_sibling(tmp_path / "d") as folder:
        folder.mkdir()
        (folder / "second").touch()
        (tmp_path / "d").mkdir()
        (tmp_path / "d/first").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["d", "first"]


def test_files_are_copied_where_links_are_impossible(tmp_path, monkeypatch):
    def refuse(self, target):
        raise OSError("no links here")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    (tmp_path / "a").write_text("content")
    link(tmp_path / "a", tmp_path / "b/c")
    assert (tmp_path / "b/c").read_text() == "content"
