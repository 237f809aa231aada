from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from dynahoi_lerobot.core.working_folder import clear, exclusive, working_folder
from dynahoi_lerobot.dataset.files import temporary_sibling
from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan
from dynahoi_lerobot.generate.shard import ShardMaker
from dynahoi_lerobot.generate.workspace import open_workspace, workspace_path
from tests.generate import recorder
from tests.generate.recorder import FakeRecipe
from tests.generate.test_command import run

PLAN = GenerationPlan(FakeRecipe(), 6, shard_episodes=2)
REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("reference") / "d"
    generate(PLAN, root, record=recorder.record)
    return hash_files(root)


@pytest.fixture
def interrupted(tmp_path) -> Path:
    """The workspace of a run that made every shard and did not come to merge them."""
    with open_workspace(PLAN, tmp_path / "d") as workspace:
        maker = ShardMaker(PLAN, workspace, recorder.record)
        for shard in range(PLAN.shards):
            maker.make(shard)
    return workspace


def flip_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def exchange_shards(workspace: Path) -> None:
    (workspace / "shard-000000").rename(workspace / "spare")
    (workspace / "shard-000001").rename(workspace / "shard-000000")
    (workspace / "spare").rename(workspace / "shard-000001")


def take_from_another_plan(workspace: Path) -> None:
    """Put a shard of the same seeds and another recipe into the place of ours."""
    root = workspace.parent / "other"
    plan = GenerationPlan(FakeRecipe(name="other"), 6, shard_episodes=2)
    with open_workspace(plan, root) as other:
        made = ShardMaker(plan, other, recorder.record).make(1)
    shutil.rmtree(workspace / "shard-000001")
    made.rename(workspace / "shard-000001")


def empty(path: Path) -> None:
    path.write_bytes(b"")


def become_an_empty_file(path: Path) -> None:
    shutil.rmtree(path)
    path.touch()


VIDEO = "shard-000001/videos/observation.images.ego/chunk-000/file-000.mp4"


@pytest.mark.parametrize(
    "damage_and_message",
    [
        (lambda folder: flip_byte(folder / VIDEO), "file-000.mp4 has changed"),
        (lambda folder: flip_byte(folder / "shard-000001/data/chunk-000/file-000.parquet"), "parquet has changed"),
        (lambda folder: empty(folder / VIDEO), "file-000.mp4 has changed"),
        (lambda folder: (folder / "shard-000001/data/extra").touch(), "data/extra is not in the manifest"),
        (exchange_shards, "its seeds are not those of shard 0"),
        (take_from_another_plan, "it belongs to another plan"),
        (lambda folder: empty(folder / "shard-000001/meta/manifest.json"), ""),
        (lambda folder: become_an_empty_file(folder / "shard-000001"), ""),
    ],
)
def test_damaged_shards_are_made_again(interrupted, reference, tmp_path, caplog, damage_and_message):
    damage, told = damage_and_message
    damage(interrupted)
    generate(PLAN, tmp_path / "d", record=recorder.record)
    assert hash_files(tmp_path / "d") == reference
    assert told in caplog.text
    assert bool(told) == ("is made again" in caplog.text)
    assert not interrupted.exists()


def test_intact_shards_are_kept(interrupted, reference, tmp_path):
    generate(PLAN, tmp_path / "d", record=recorder.record_and_die)  # ends the process if it is asked for an episode
    assert hash_files(tmp_path / "d") == reference


def test_shards_that_are_damaged_again_and_again_end_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(ShardMaker, "problem", lambda self, shard: "it has changed" if shard == 1 else None)
    with pytest.raises(GenerationError, match="damaged 3 times after they were made; check the disk"):
        generate(PLAN, tmp_path / "d", record=recorder.record)
    assert not (tmp_path / "d").exists()


def test_a_file_in_the_place_of_a_shard_is_refused_and_kept(interrupted, tmp_path):
    shutil.rmtree(interrupted / "shard-000001")
    (interrupted / "shard-000001").write_text("mine")
    with pytest.raises(FileExistsError, match="shard-000001 is a file, where a shard belongs; remove it"):
        generate(PLAN, tmp_path / "d", record=recorder.record)
    assert (interrupted / "shard-000001").read_text() == "mine"


def refused(root: Path, capsys) -> str:
    """Generate through the command, which must refuse; return its sentence."""
    assert run("--root", root, "--episodes", 6, "--shard-episodes", 2) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_a_folder_without_our_plan_is_refused_and_kept(tmp_path, capsys):
    foreign = workspace_path(tmp_path / "d")
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("mine")
    assert "d.partial holds thesis.tex but no plan.json" in refused(tmp_path / "d", capsys)
    assert [path.name for path in tmp_path.rglob("*")] == ["d.partial", "thesis.tex"]


def test_a_workspace_that_lost_its_plan_is_refused_under_any_seed(interrupted, tmp_path, capsys):
    (interrupted / "plan.json").unlink()
    assert run("--root", tmp_path / "d", "--episodes", 6, "--shard-episodes", 2, "--seed", 100) == 2
    assert "holds shard-000000 but no plan.json" in capsys.readouterr().err


def test_an_unreadable_plan_is_refused(interrupted, tmp_path, capsys):
    empty(interrupted / "plan.json")
    assert "plan.json cannot be read" in refused(tmp_path / "d", capsys)


def test_a_file_in_the_place_of_the_workspace_is_refused(tmp_path, capsys):
    workspace_path(tmp_path / "d").touch()
    assert "d.partial is a file" in refused(tmp_path / "d", capsys)


def test_files_that_generation_did_not_make_stay(interrupted, tmp_path, caplog):
    (interrupted / "notes.txt").write_text("mine")
    generate(PLAN, tmp_path / "d", record=recorder.record)
    assert [path.name for path in interrupted.iterdir()] == ["notes.txt"]
    assert "did not make all that is in it: notes.txt" in caplog.text


def test_only_what_an_ended_process_of_this_host_left_is_removed(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    host, running = socket.gethostname(), os.getppid()
    stale = [f".d.{host}.{ended.pid}.00000000.tmp", f".d.{host}.{os.getpid()}.00000000.tmp"]
    kept = [".d.notes.tmp", f".d.elsewhere.{ended.pid}.00000000.tmp", f".d.{host}.{running}.00000000.tmp"]
    for name in stale + kept:
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    with temporary_sibling(tmp_path / "d") as folder:
        folder.mkdir()
    assert {path.name for path in tmp_path.iterdir()} == {"d", *kept}
    assert all((tmp_path / name / "file").exists() for name in kept)


def test_a_finished_dataset_is_checked(tmp_path, capsys):
    words = ("--root", tmp_path / "d", "--episodes", 6, "--shard-episodes", 2)
    assert run(*words) == 0
    assert "already complete" not in capsys.readouterr().err
    assert run(*words) == 0
    assert "was already complete" in capsys.readouterr().err
    flip_byte(tmp_path / "d/data/chunk-000/file-000.parquet")
    assert run(*words) == 1
    assert "is complete but damaged: data/chunk-000/file-000.parquet has changed" in capsys.readouterr().err


def test_a_second_process_is_told_so(tmp_path, capsys):
    root = tmp_path / "d"
    with open_workspace(PLAN, root):
        assert run("--root", root, "--episodes", 6, "--shard-episodes", 2) == 1
    told = capsys.readouterr().err
    assert f"process {os.getpid()} on {socket.gethostname()} works in {workspace_path(root)}; wait" in told
    assert told.count("\n") == 1
    assert run("--root", root, "--episodes", 6, "--shard-episodes", 2) == 0


HOLDER = """
import sys, time
from pathlib import Path
from dynahoi_lerobot.core.working_folder import exclusive
with exclusive(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=REPOSITORY) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(BlockingIOError, match=f"process {holder.pid} on"), exclusive(tmp_path):
            pass
        holder.kill()
    assert (tmp_path / "lock").exists()
    with exclusive(tmp_path):
        assert (tmp_path / "lock").read_text().startswith(f"process {os.getpid()} on")
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
