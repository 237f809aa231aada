"""A dataset is a function of its plan, whoever makes it, in whatever pieces and whatever goes wrong
meanwhile.
"""

import dataclasses
import json
import shutil
from functools import partial
from pathlib import Path

import pytest

from dynahoi_lerobot.core.arguments import CommandError
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.generate import pipeline
from dynahoi_lerobot.generate.pipeline import generate, open_workspace, workspace_path
from dynahoi_lerobot.generate.plan import GenerationPlan, ShardMaker
from dynahoi_lerobot.sampling.splits import MAX_DRAWS, REDRAW_STRIDE
from tests.generate import recorder
from tests.generate.recorder import PLAN, FakeRecording
from tests.generate.test_command import run
from tests.tools import flip_byte


def plan(episodes: int = 10, seed: int = 0, shard_episodes: int = 3, **recording) -> GenerationPlan:
    return GenerationPlan(FakeRecording(**recording), episodes, seed, shard_episodes=shard_episodes)


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> Path:
    """Ten episodes made without disturbance."""
    root = tmp_path_factory.mktemp("reference") / "d"
    generate(plan(), root, record=recorder.record)
    return root


def same(first: Path, second: Path) -> bool:
    return hash_files(first) == hash_files(second) and Manifest.read(first) == Manifest.read(second)


def test_slots_follow_the_seed(reference):
    manifest = Manifest.read(reference)
    assert manifest.seeds == list(range(10))
    assert manifest.yields == {"tried": 10, "kept": 10, "failed": 0, "missed": 0, "rejected": 0}
    assert manifest.provenance["recording"] == json.loads(json.dumps(FakeRecording().stored()))
    assert not workspace_path(reference).exists()
    assert plan(episodes=10, seed=5).slots(3) == range(14, 15)


def test_any_shard_size_gives_the_same_tables_and_videos_and_progress_counts_episodes(
    reference, tmp_path
):
    seen: list[int] = []
    generate(plan(shard_episodes=4), tmp_path / "d", record=recorder.record, progress=seen.append)
    assert seen == [*range(1, 11), 10]
    one = hash_files(reference)
    other = hash_files(tmp_path / "d")
    assert {name for name in one if one[name] != other[name]} == {"README.md"}, (
        "which shows the plan"
    )


@pytest.mark.parametrize("workers", [1, 2])
def test_a_shard_is_merged_before_all_are_made(workers, reference, tmp_path, monkeypatch):
    made: list[int] = []
    copy = DatasetWriter.copy
    merged = tmp_path / "merged"

    def copy_and_look(*args):
        made.append(len(list(workspace_path(tmp_path / "d").glob("shard-*"))))
        copy(*args)
        merged.touch()

    monkeypatch.setattr(DatasetWriter, "copy", copy_and_look)
    record = partial(recorder.record_the_last_after, merged)
    generate(plan(), tmp_path / "d", record=record, workers=workers)
    assert made[0] < made[-1] == plan().shards
    assert same(reference, tmp_path / "d")


def test_a_shard_that_two_processes_make_at_once_is_kept_from_one(tmp_path):
    def record_twice(recording, seeds):
        ShardMaker(plan(), tmp_path, recorder.record).make(0)
        yield from recorder.record(recording, seeds)

    maker = ShardMaker(plan(), tmp_path, record_twice)
    maker.make(0)
    assert maker.problem(0) is None


def test_missed_slots_are_drawn_again(tmp_path):
    manifest = generate(plan(miss_every=4, seed=1), tmp_path / "d", record=recorder.record)
    assert {seed % REDRAW_STRIDE for seed in manifest.seeds} == set(range(1, 11))
    assert sorted(manifest.seeds)[-2:] == [4 + REDRAW_STRIDE, 8 + REDRAW_STRIDE]
    assert manifest.yields == {"tried": 12, "kept": 10, "failed": 0, "missed": 2, "rejected": 0}


def test_corrupt_recordings_are_rejected_and_drawn_again(tmp_path):
    manifest = generate(plan(), tmp_path / "d", record=recorder.record_with_nan)
    assert manifest.yields == {"tried": 11, "kept": 10, "failed": 0, "missed": 0, "rejected": 1}
    assert 3 not in manifest.seeds
    assert 3 + REDRAW_STRIDE in manifest.seeds


def test_an_impossible_recipe_ends_with_a_sentence(tmp_path):
    with pytest.raises(
        CommandError, match=f"failed {MAX_DRAWS} times on each of 3 slots, the first of seed 0"
    ):
        generate(plan(hopeless=True), tmp_path / "d", record=recorder.record)
    assert not any(tmp_path.iterdir()), (
        "what made nothing leaves no folder that blocks another plan"
    )


@pytest.mark.slow
def test_two_workers_of_which_one_dies_and_is_replaced_give_the_bytes_of_one(tmp_path):
    marker = plan(name=str(tmp_path / "marker"))
    generate(marker, tmp_path / "died", record=recorder.record_and_die_once, workers=2)
    assert (tmp_path / "marker").exists()
    generate(marker, tmp_path / "lived", record=recorder.record_and_die_once)
    assert same(tmp_path / "died", tmp_path / "lived")


def test_workers_that_keep_dying_end_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "STARTS", 1)
    with pytest.raises(CommandError, match="died 1 times with 4 shards to go"):
        generate(plan(), tmp_path / "d", record=recorder.record_and_die, workers=2)
    assert not (tmp_path / "d").exists()


def test_other_datasets_are_left_alone(reference, tmp_path):
    before = hash_files(reference)
    generate(plan(), reference, record=recorder.record_and_die)  # done already
    with pytest.raises(
        FileExistsError, match=r"another dataset .other name, episodes, shard_episodes"
    ):
        generate(plan(shard_episodes=2, episodes=3, name="x"), reference, record=recorder.record)
    assert hash_files(reference) == before
    (tmp_path / "precious").mkdir()
    with pytest.raises(FileExistsError, match="no dataset of ours"):
        generate(plan(), tmp_path / "precious", record=recorder.record)


@pytest.fixture
def interrupted(once, tmp_path) -> Path:
    """The workspace of a run that made every shard and did not come to merge them."""

    def make(root: Path) -> Path:
        with open_workspace(PLAN, root) as workspace:
            maker = ShardMaker(PLAN, workspace, recorder.record)
            for shard in range(PLAN.shards):
                maker.make(shard)
        return workspace

    return shutil.copytree(once("interrupted", make), workspace_path(tmp_path / "d"))


def exchange_shards(workspace: Path) -> None:
    (workspace / "shard-000000").rename(workspace / "spare")
    (workspace / "shard-000001").rename(workspace / "shard-000000")
    (workspace / "spare").rename(workspace / "shard-000001")


def take_from_another_plan(workspace: Path) -> None:
    """Put a shard of the same seeds and another recipe into the place of ours."""
    other_plan = dataclasses.replace(PLAN, recording=FakeRecording(name="other"))
    with open_workspace(other_plan, workspace.parent / "other") as other:
        ShardMaker(other_plan, other, recorder.record).make(1)
    shutil.rmtree(workspace / "shard-000001")
    (other / "shard-000001").rename(workspace / "shard-000001")


VIDEO = "shard-000001/videos/observation.images.ego/chunk-000/file-000.mp4"


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: flip_byte(folder / VIDEO),
        lambda folder: flip_byte(folder / "shard-000001/data/chunk-000/file-000.parquet"),
        exchange_shards,
        take_from_another_plan,
        lambda folder: (folder / "shard-000001/meta/manifest.json").write_bytes(b""),
    ],
)
def test_damaged_shards_are_made_again(interrupted, undisturbed, tmp_path, damage):
    damage(interrupted)
    generate(PLAN, tmp_path / "d", record=recorder.record)
    assert hash_files(tmp_path / "d") == undisturbed
    assert not interrupted.exists()


def test_intact_shards_are_kept(interrupted, undisturbed, tmp_path):
    (interrupted / "shard-000000000009").mkdir()  # beyond the plan
    generate(PLAN, tmp_path / "d", record=recorder.record_and_die)
    assert hash_files(tmp_path / "d") == undisturbed


def test_a_finished_dataset_is_checked(tmp_path, capsys):
    words = ("--root", tmp_path / "d", "--episodes", 6, "--shard-episodes", 2)
    assert [run(*words), run(*words)] == [0, 0]
    flip_byte(tmp_path / "d/data/chunk-000/file-000.parquet")
    assert run(*words) == 1
    assert "is complete but damaged: data/chunk-000/file-000.parquet" in capsys.readouterr().err
