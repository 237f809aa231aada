from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.generate.executors import EXECUTORS, ClusterResources
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from tests.generate import recorder
from tests.generate.recorder import FakeRecipe
from tests.generate.test_command import run


@pytest.fixture
def plan() -> GenerationPlan:
    """Seven episodes in four shards, planned by the code as it is now, like that of the processes started next."""
    code_fingerprint.cache_clear()
    return GenerationPlan(FakeRecipe(), 7, shard_episodes=2)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The dataset as one process makes it."""
    root = tmp_path_factory.mktemp("alone") / "d"
    generate(GenerationPlan(FakeRecipe(), 7, shard_episodes=2), root, record=recorder.record)
    return root


def same(first, second) -> bool:
    one, other = Manifest.read(first), Manifest.read(second)
    return hash_files(first) == hash_files(second) == other.files and one.seeds == other.seeds


def test_local_tasks_give_the_same_bytes(plan, alone, tmp_path):
    executor = EXECUTORS["local"](plan, tmp_path / "d", recorder.record, ClusterResources(tasks=3, workers=1))
    assert executor.run() is True
    assert same(alone, tmp_path / "d")
    assert not list((tmp_path / "d.partial").glob("shard-*"))
    assert executor.run() is True, "done already"


@pytest.mark.slow
def test_local_processes_through_the_command(plan, alone, tmp_path):
    words = ("--root", tmp_path / "d", "--episodes", 7, "--shard-episodes", 2)
    assert run(*words, "--executor", "local", "--tasks", 2, "--workers", 2) == 0
    assert same(alone, tmp_path / "d")
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_finished_tasks_are_skipped_and_lost_work_is_done_again(plan, alone, tmp_path):
    executor = EXECUTORS["local"](plan, tmp_path / "d", recorder.record_until_marked, ClusterResources(workers=1))
    folder, stop = executor.maker.folder, tmp_path / "stop"
    stop.touch()
    recorder.STOP.append(stop)
    try:
        with pytest.raises(RuntimeError, match="stopped"):
            executor.run()
        assert [path.name for path in folder.glob("shard-*")] == ["shard-000000", "shard-000001"]
        stop.unlink()
        shutil.rmtree(folder / "shard-000000")
        made = recorder.CALLS.copy()
        executor.run()
    finally:
        recorder.STOP.clear()
    assert recorder.CALLS[len(made) :] == [range(0, 2), range(4, 6), range(6, 7)]
    assert same(alone, tmp_path / "d")


BELOW_UV = "import subprocess, sys; sys.exit(subprocess.call(sys.argv[1:]))"
"""What ``uv run`` does: start Python as a child. Ray looks for such a parent."""

RAY = """
import sys
from pathlib import Path
from dynahoi_lerobot.generate.executors import EXECUTORS, ClusterResources
from dynahoi_lerobot.generate.plan import GenerationPlan
from tests.generate import recorder

plan = GenerationPlan(recorder.FakeRecipe(), 7, shard_episodes=2)
resources = ClusterResources(tasks=2, mem_per_cpu_gb=1)
assert EXECUTORS["ray"](plan, Path(sys.argv[1]), recorder.record, resources).run() is True
"""


def run_with_deadline(command: list[str], folder: Path, seconds: float, **options: str) -> str:
    """Run a process and all that it starts, for so long at most; return its errors, or fail with them."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])} | options
    with (folder / "errors.txt").open("w+") as errors:
        process = subprocess.Popen(
            command, executable=sys.executable, cwd=folder, env=environment, stdout=errors, stderr=errors,
            start_new_session=True,
        )  # fmt: skip
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        errors.seek(0)
        told = errors.read()
    assert code == 0, f"ended with {code} (None: after {seconds:.0f} s): {told[-2000:]}"
    return told


@pytest.mark.slow
def test_ray_tasks_give_the_same_bytes_below_uv_run(alone, tmp_path):
    (tmp_path / "run").write_text(BELOW_UV)
    (tmp_path / "script.py").write_text(RAY)
    command = ["uv", "run", sys.executable, str(tmp_path / "script.py"), str(tmp_path / "d")]
    run_with_deadline(command, tmp_path, 150)
    assert same(alone, tmp_path / "d")


BROKEN_RAY = """
import sys
from pathlib import Path
import ray
from dynahoi_lerobot.generate import executors
from dynahoi_lerobot.generate.executors import EXECUTORS, ClusterResources
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan
from tests.generate import recorder

def refused(start_s, **resources):
    executors.START_S = start_s
    plan = GenerationPlan(recorder.FakeRecipe(), 7, shard_episodes=2)
    try:
        EXECUTORS["ray"](plan, Path(sys.argv[1]), recorder.record, ClusterResources(tasks=2, **resources)).run()
    except GenerationError as error:
        print(error)

ray.init(num_cpus=2, include_dashboard=False, runtime_env={"py_executable": "false"})
refused(4.0, mem_per_cpu_gb=1)
refused(60.0, cpus_per_task=3, mem_per_cpu_gb=1)
"""


@pytest.mark.slow
def test_ray_that_cannot_work_says_so(tmp_path):
    (tmp_path / "script.py").write_text(BROKEN_RAY)
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "d")]
    told = run_with_deadline(command, tmp_path, 120, RAY_ENABLE_UV_RUN_RUNTIME_ENV="0")
    assert "Ray ran no task within 4 s (GetTimeoutError); the logs of its session_" in told
    assert "a task needs 3 CPUs, 0 GPUs and 3 GB, and no machine of the Ray cluster has them: 2 CPUs, 0 GPUs" in told
    assert not (tmp_path / "d").exists()


def test_slurm_scripts_can_be_seen(tmp_path, capsys):
    words = ("--root", tmp_path / "d", "--executor", "slurm", "--dry-run", "--partition", "hopper", "--tasks", 3)
    more = ("--episodes", 7, "--shard-episodes", 2, "--cpus-per-task", 8, "--gpus-per-task", 1, "--time", "01:00:00")
    assert run(*words, *more) == 0
    shards, merge = capsys.readouterr().out.split("# submitted with --dependency=afterok")
    for line in (
        "#SBATCH --partition=hopper", "#SBATCH --array=0-2", "#SBATCH --cpus-per-task=8", "#SBATCH --gpus=1",
        "#SBATCH --time=01:00:00", "#SBATCH --job-name=dynahoi-shards-d", f"source {sys.prefix}/bin/activate",
    ):  # fmt: skip
        assert line in shards
    assert f"launch_pickled_pipeline {tmp_path}/d.partial/logs/shards/executor.pik" in shards
    assert "#SBATCH --array=0-0" in merge
    assert "dynahoi-merge-d" in merge
    assert not any(tmp_path.iterdir()), "nothing was written"


def test_slurm_submits_two_jobs(tmp_path, monkeypatch, capsys):
    from datatrove.executor import slurm

    calls = []

    def sbatch(contents, job_id_retriever, *args):
        calls.append((contents, args))
        return str(100 + len(calls))

    monkeypatch.setattr(slurm, "launch_slurm_job", sbatch)
    assert run("--root", tmp_path / "d", "--executor", "slurm", "--episodes", 7, "--shard-episodes", 2) == 0
    jobs = [(contents, args) for contents, args in calls if "merge_stats" not in contents]
    assert ["dynahoi-shards" in jobs[0][0], "dynahoi-merge" in jobs[1][0]] == [True, True]
    assert "--dependency=afterok:101" in jobs[1][1]
    assert (tmp_path / "d.partial/logs/shards/executor.pik").is_file()
    assert not (tmp_path / "d").exists()


def test_machines_with_other_code_refuse_to_work(plan, tmp_path):
    other = dataclasses.replace(plan, code="0123")
    with pytest.raises(GenerationError, match="made by code 0123, this machine has"):
        EXECUTORS["local"](other, tmp_path / "d", recorder.record, ClusterResources(workers=1)).run()


def test_failed_tasks_are_an_error(plan, tmp_path):
    executor = EXECUTORS["local"](plan, tmp_path / "d", recorder.record, ClusterResources())
    executor.maker.folder.mkdir()
    with pytest.raises(GenerationError, match=r"4 of 4 shards failed; see .*logs/shards/logs"):
        executor.require_all_shards()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--executor", "cloud"), "unknown executor 'cloud'; known: local, ray, slurm"),
        (("--executor", "local", "--tasks", 0), "tasks is 0"),
    ],
)
def test_bad_fleets_are_one_sentence(tmp_path, capsys, words, sentence):
    assert run("--root", tmp_path / "d", *words) == 2
    assert sentence in capsys.readouterr().err


def test_missing_library_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "datatrove.executor", None)
    monkeypatch.setitem(sys.modules, "datatrove", None)
    monkeypatch.delitem(sys.modules, "dynahoi_lerobot.generate.datatrove_steps", raising=False)
    assert run("--root", tmp_path / "d", "--executor", "local") == 2
    assert "`scale`" in capsys.readouterr().err
