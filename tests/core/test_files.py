"""What is made appears whole or not at all; folders are claimed by one process."""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from dynahoi_lerobot.core.files import new_folder, write_atomically
from dynahoi_lerobot.core.working_folder import exclusive, working_folder

HOLDER = """
import sys, time
from pathlib import Path
from dynahoi_lerobot.core.working_folder import exclusive
with exclusive(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_killed_process_loses_its_lock(tmp_path: Path):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(BlockingIOError, match=f"process {process.pid} on"), exclusive(tmp_path):
            pass
        process.kill()
    assert (tmp_path / "lock").exists()
    with exclusive(tmp_path):
        assert str(os.getpid()) in (tmp_path / "lock").read_text()
    assert not (tmp_path / "lock").exists()


@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_a_link_in_the_place_of_a_lock_does_not_lose_what_it_leads_to(link, tmp_path: Path):
    thesis = tmp_path / "thesis.tex"
    thesis.write_text("precious")
    folder = tmp_path / "work"
    folder.mkdir()
    link(folder / "lock", thesis)
    with pytest.raises(FileExistsError, match="link"), exclusive(folder):
        pass
    assert thesis.read_text() == "precious"


def test_only_the_folder_of_the_same_task_is_entered(tmp_path: Path):
    folder = tmp_path / "work"
    foreign = tmp_path / "foreign"
    with pytest.raises(RuntimeError), working_folder(folder, {}):
        raise RuntimeError
    assert not folder.exists(), "what fails before it made anything leaves nothing"
    folder.mkdir()
    (folder / ".plan.json.1.part").write_text('{"tas')  # of a start that was killed
    with working_folder(folder, {"recipe": {"split": "val"}}):
        (folder / "file").touch()
    assert sorted(path.name for path in folder.iterdir()) == ["file", "plan.json"]
    with (
        pytest.raises(FileExistsError, match="split"),
        working_folder(folder, {"recipe": {"split": "test"}}),
    ):
        pass
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("mine")
    with pytest.raises(FileExistsError, match=r"thesis\.tex"), working_folder(foreign, {}):
        pass


def test_a_folder_appears_whole_or_not_at_all_and_the_first_of_two_wins(tmp_path: Path):
    with suppress(RuntimeError), new_folder(tmp_path / "d") as folder:
        folder.mkdir()
        (folder / "half").touch()
        raise RuntimeError
    assert not any(tmp_path.iterdir())

    def make(*names: str) -> None:
        with new_folder(tmp_path / "d") as folder:
            folder.mkdir()
            (folder / names[0]).touch()
            if names[1:]:
                make(*names[1:])

    with pytest.raises(FileExistsError, match="another process"):
        make("second", "first")
    assert [path.name for path in tmp_path.rglob("*")] == ["d", "first"]


def test_files_that_belong_together_appear_together(tmp_path: Path):
    files = [tmp_path / "out" / name for name in "ab"]

    def fail(path: Path) -> None:
        assert not any(file.exists() for file in files)
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        write_atomically({files[0]: lambda path: path.write_text("new"), files[1]: fail})
    assert not any((tmp_path / "out").iterdir())
    for text in ("one", "two"):
        write_atomically(
            {
                file: lambda path, text=text, name=file.name: path.write_text(text + name)
                for file in files
            }
        )
    assert [file.read_text() for file in files] == ["twoa", "twob"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a", "b"]


def test_what_a_killed_process_left_of_a_folder_is_removed_and_a_living_ones_is_not(tmp_path: Path):
    code = (
        "import os, sys; from pathlib import Path; from dynahoi_lerobot.core.files import "
        "new_folder\n"
    )
    code += (
        "with new_folder(Path(sys.argv[1])) as f: f.mkdir(); print(end='', flush=True); "
        "os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    with new_folder(tmp_path / "out") as first:
        with suppress(RuntimeError), new_folder(tmp_path / "out") as second:
            assert sorted(tmp_path.iterdir()) == sorted([first.parent, second.parent])
            raise RuntimeError
        first.mkdir()
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]
