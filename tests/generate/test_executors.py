"""Shards as tasks of datatrove: the same bytes as one process makes, on this machine, on Ray, and
handed to Slurm.
"""

import dataclasses
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.dataset.manifest import hash_files
from dynahoi_lerobot.generate import executors
from dynahoi_lerobot.generate.executors import ClusterResources
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from tests.generate import recorder
from tests.generate.recorder import PLAN
from tests.generate.test_command import run


@pytest.fixture
def plan() -> GenerationPlan:
    """Planned by the code as it is now, like that of the processes started next."""
    code_fingerprint.cache_clear()
    return dataclasses.replace(PLAN, code=code_fingerprint())


def test_local_tasks_give_the_same_bytes(plan, undisturbed, tmp_path):
    work = ("local", plan, tmp_path / "d", recorder.record, ClusterResources(tasks=3, workers=1))
    assert executors.run(*work) is True
    assert hash_files(tmp_path / "d") == undisturbed
    assert not list((tmp_path / "d.partial").glob("shard-*"))
    assert executors.run(*work) is True, "done already"


BELOW_UV = "import subprocess, sys; sys.exit(subprocess.call(sys.argv[1:]))"
"""What ``uv run`` does: start Python as a child. Ray looks for such a parent."""
RAY = """
import sys
from pathlib import Path
from dynahoi_lerobot.generate import executors
from tests.generate import recorder

resources = executors.ClusterResources(tasks=2, mem_per_cpu_gb=1)
assert executors.run("ray", recorder.PLAN, Path(sys.argv[1]), recorder.record, resources) is True
"""


@pytest.mark.slow
def test_ray_tasks_give_the_same_bytes_below_uv_run(undisturbed, tmp_path):
    (tmp_path / "run").write_text(BELOW_UV)
    (tmp_path / "script.py").write_text(RAY)
    command = ["uv", "run", sys.executable, str(tmp_path / "script.py"), str(tmp_path / "d")]
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    with (tmp_path / "errors.txt").open("w") as errors:
        process = subprocess.Popen(
            command,
            executable=sys.executable,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": path},
            stdout=errors,
            stderr=errors,
            start_new_session=True,
        )
        try:
            code = process.wait(300)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert code == 0, (tmp_path / "errors.txt").read_text()[-2000:]
    assert hash_files(tmp_path / "d") == undisturbed


def test_slurm_scripts_can_be_seen(tmp_path, capsys):
    words = (
        "--root",
        tmp_path / "d",
        "--executor",
        "slurm",
        "--dry-run",
        "--partition",
        "hopper",
        "--tasks",
        3,
    )
    more = (
        "--episodes",
        7,
        "--shard-episodes",
        2,
        "--cpus-per-task",
        8,
        "--gpus-per-task",
        1,
        "--time",
        "01:00:00",
    )
    assert run(*words, *more) == 0
    shards, merge = capsys.readouterr().out.split("# submitted with --dependency=afterok")
    for line in (
        "#SBATCH --partition=hopper",
        "#SBATCH --array=0-2",
        "#SBATCH --cpus-per-task=8",
        "#SBATCH --gpus=1",
        "#SBATCH --time=01:00:00",
        "#SBATCH --job-name=dynahoi-shards-d",
        f"source {sys.prefix}/bin/activate",
        f"launch_pickled_pipeline {tmp_path}/d.partial/logs/shards/executor.pik",
    ):
        assert line in shards
    assert "#SBATCH --array=0-0" in merge
    assert "dynahoi-merge-d" in merge
    assert not any(tmp_path.iterdir()), "nothing was written"


def test_slurm_submits_two_jobs(tmp_path, monkeypatch):
    from datatrove.executor import slurm

    calls = []

    def sbatch(contents, job_id_retriever, *args):
        calls.append((contents, args))
        return str(100 + len(calls))

    monkeypatch.setattr(slurm, "launch_slurm_job", sbatch)
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    assert (
        run("--root", tmp_path / "d", "--executor", "slurm", "--episodes", 7, "--shard-episodes", 2)
        == 0
    )
    jobs = [(contents, args) for contents, args in calls if "merge_stats" not in contents]
    assert ["dynahoi-shards" in jobs[0][0], "dynahoi-merge" in jobs[1][0]] == [True, True]
    assert "--dependency=afterok:101" in jobs[1][1]
    assert (tmp_path / "d.partial/logs/shards/executor.pik").is_file()
    assert not (tmp_path / "d").exists()


def test_machines_with_other_code_refuse_to_work(plan, tmp_path):
    other = dataclasses.replace(plan, code="0123")
    with pytest.raises(CommandError, match="made by code 0123, this machine has"):
        executors.run("local", other, tmp_path / "d", recorder.record, ClusterResources(workers=1))


def test_shards_that_are_missing_are_not_merged(plan, tmp_path):
    maker = executors.ShardMaker(plan, tmp_path / "d.partial", recorder.record)
    with pytest.raises(CommandError, match="3 of 3 shards are missing"):
        executors.merge_shards(maker, tmp_path / "d")


def test_missing_library_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "datatrove.executor", None)
    monkeypatch.setitem(sys.modules, "datatrove", None)
    monkeypatch.delitem(sys.modules, "dynahoi_lerobot.generate.executors", raising=False)
    monkeypatch.delattr("dynahoi_lerobot.generate.executors", raising=False)
    assert run("--root", tmp_path / "d", "--executor", "local") == 2
    assert "`scale`" in capsys.readouterr().err
