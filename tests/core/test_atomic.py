"""Working folders are claimed by one process and cleared of nothing else; what is made appears whole or not at all."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from dynahoi_lerobot.core.atomic import new_folder
from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.working_folder import clear, exclusive, working_folder

HOLDER = """
import sys, time
from pathlib import Path
from dynahoi_lerobot.core.{module} import {name}
with {call}:
    print("held", flush=True)
    time.sleep(60)
"""


def holder(call: str, folder: Path) -> subprocess.Popen:
    """Start a process that enters a context, and wait until it is in there."""
    name, module = call.split("(", maxsplit=1)[0], "atomic" if "new_folder" in call else "working_folder"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER.format(module=module, name=name, call=call), str(folder)], stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    return process


def test_the_draft_of_a_start_that_was_killed_does_not_stay(tmp_path):
    (tmp_path / ".plan.json.1.part").write_text('{"tas')
    with working_folder(tmp_path, {"task": 1}):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]


def test_a_killed_process_loses_its_lock(tmp_path):
    with holder("exclusive(Path(sys.argv[1]))", tmp_path) as process:
        with pytest.raises(BlockingIOError, match=f"process {process.pid} on"), exclusive(tmp_path):
            pass
        process.kill()
    assert (tmp_path / "lock").exists()
    with exclusive(tmp_path):
        assert (tmp_path / "lock").read_text().startswith(f"process {os.getpid()} on {socket.gethostname()}")
    assert not (tmp_path / "lock").exists()


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "lock").symlink_to(tmp_path / "thesis.tex")
    with pytest.raises(FileExistsError), exclusive(tmp_path / "d"):
        pass
    assert (tmp_path / "thesis.tex").read_text() == "mine"


def test_only_the_folder_of_the_same_task_is_cleared(tmp_path):
    folder, task = tmp_path / "work", {"recipe": {"split": "val"}}
    with working_folder(folder, task):
        (folder / "file").touch()
    with pytest.raises(FileExistsError, match="other split"):
        clear(folder, {"recipe": {"split": "test"}})
    assert (folder / "file").exists()
    clear(folder, task)
    assert not folder.exists()
    folder.mkdir()
    (folder / "thesis.tex").write_text("mine")
    with pytest.raises(FileExistsError, match=r"thesis.tex but no"):
        clear(folder, task)
    assert (folder / "thesis.tex").exists()


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    def fail() -> None:
        with new_folder(tmp_path / "d") as folder:
            folder.mkdir()
            (folder / "half").touch()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert not any(tmp_path.iterdir())
    with new_folder(tmp_path / "d") as folder:
        folder.mkdir()
        (folder / "whole").touch()
        assert not (tmp_path / "d").exists()
    assert [path.name for path in tmp_path.rglob("*")] == ["d", "whole"]


def test_what_a_killed_process_left_is_removed_and_what_is_not_ours_stays(tmp_path):
    with holder("new_folder(Path(sys.argv[1]) / 'd') as made", tmp_path) as process:
        (tmp_path / ".d.tmp" / "d").mkdir()
        (tmp_path / ".d.tmp" / "d" / "half").touch()
        with pytest.raises(BlockingIOError, match=f"process {process.pid}"), new_folder(tmp_path / "d"):
            pass
        process.kill()
    with new_folder(tmp_path / "d") as folder:
        folder.mkdir()
    assert [path.name for path in tmp_path.rglob("*")] == ["d"]
    (tmp_path / ".e.tmp").mkdir()
    (tmp_path / ".e.tmp" / "thesis.tex").write_text("mine")
    with pytest.raises(FileExistsError, match=r"thesis\.tex"), new_folder(tmp_path / "e"):
        pass
    assert (tmp_path / ".e.tmp" / "thesis.tex").exists()


def test_the_first_of_two_processes_wins(tmp_path):
    with new_folder(tmp_path / "d") as folder:
        folder.mkdir()
        (folder / "second").touch()
        (tmp_path / "d").mkdir()
        (tmp_path / "d/first").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["d", "first"]


def test_files_that_belong_together_appear_together(tmp_path):
    files = [tmp_path / "out" / name for name in "ab"]

    def fail(path: Path) -> None:
        assert not any(file.exists() for file in files)
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        write_atomically({files[0]: lambda path: path.write_text("new"), files[1]: fail})
    assert not any((tmp_path / "out").iterdir())
    for text in ("one", "two"):
        write_atomically({file: lambda path, text=text, name=file.name: path.write_text(text + name) for file in files})
    assert [file.read_text() for file in files] == ["twoa", "twob"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a", "b"]
