from __future__ import annotations

import dataclasses
import errno
import itertools
import json
import re

import numpy as np
import pytest

from dynahoi_lerobot.core.compatibility import MixedError
from dynahoi_lerobot.dataset import read_episodes, write_episodes
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.video import decode
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.generate import workers
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationError, GenerationPlan, shard_size
from dynahoi_lerobot.generate.workspace import workspace_path
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.splits import MAX_DRAWS, REDRAW_STRIDE
from dynahoi_lerobot.verify.runner import verify
from tests.dataset.episodes import varied_episode, write
from tests.generate import recorder
from tests.generate.recorder import FakeRecipe


def plan(episodes: int = 10, seed: int = 0, shard_episodes: int = 3, **recipe) -> GenerationPlan:
    return GenerationPlan(FakeRecipe(**recipe), episodes, seed, shard_episodes=shard_episodes)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Ten episodes made without disturbance."""
    root = tmp_path_factory.mktemp("reference") / "d"
    generate(plan(), root, record=recorder.record)
    return root


def same(first, second) -> bool:
    return hash_files(first) == hash_files(second) and Manifest.read(first) == Manifest.read(second)


@pytest.mark.parametrize(("episodes", "size"), [(1, 1), (5, 1), (80, 10), (81, 11), (2048, 256), (10**6, 256)])
def test_shards_grow_with_the_dataset_up_to_a_size_that_is_cheap_to_redo(episodes: int, size: int):
    assert shard_size(episodes) == size


def test_slots_follow_the_seed(reference):
    assert Manifest.read(reference).seeds == list(range(10))
    assert Manifest.read(reference).yields == {"tried": 10, "kept": 10, "failed": 0, "missed": 0, "rejected": 0}
    assert not workspace_path(reference).exists()
    assert plan(episodes=10, seed=5).slots(3) == range(14, 15)


def test_any_number_of_workers_gives_the_same_bytes(reference, tmp_path):
    generate(plan(), tmp_path / "d", record=recorder.record, workers=2)
    assert same(reference, tmp_path / "d")


def test_any_shard_size_gives_the_same_frames(reference, tmp_path):
    generate(plan(shard_episodes=4), tmp_path / "d", record=recorder.record)
    assert not same(reference, tmp_path / "d")
    assert (tmp_path / "d/meta/stats.json").read_bytes() == (reference / "meta/stats.json").read_bytes()
    for one, other in zip(read_episodes(reference), read_episodes(tmp_path / "d"), strict=True):
        assert one.meta == other.meta
        assert (one.action == other.action).all()


def test_one_shard_is_merged_to_itself(tmp_path):
    single = write(tmp_path / "single", range(5))
    merge([single], tmp_path / "merged")
    assert hash_files(single) == hash_files(tmp_path / "merged")


def test_merging_is_the_same_as_writing_at_once_but_for_how_packets_are_put_into_the_video(tmp_path):
    parts = [write(tmp_path / "a", range(3)), write(tmp_path / "b", range(3, 5))]
    merged, whole = merge(parts, tmp_path / "merged"), write(tmp_path / "whole", range(5))
    ours, theirs = hash_files(tmp_path / "merged"), hash_files(whole)
    assert set(ours) == set(theirs), "one file a view, without which LeRobot streams wrong pictures"
    video = "videos/observation.images.ego/chunk-000/file-000.mp4"
    assert {name for name in theirs if ours[name] != theirs[name]} <= {"README.md", video}  # it names all hashes
    assert merged.seeds == Manifest.read(whole).seeds
    apart = [frame for part in parts for frame in decode(part / video)]
    np.testing.assert_array_equal(list(decode(tmp_path / "merged" / video)), apart)
    findings = verify(tmp_path / "merged", decoded=None)
    assert not [finding for finding in findings if finding.check in ("videos", "files")]


@pytest.mark.parametrize("limits", [FileLimits(video_s=3.0), FileLimits(video_mb=0.001)])
def test_videos_that_would_be_too_long_or_too_large_stay_apart_and_are_linked(tmp_path, limits: FileLimits):
    parts = [write(tmp_path / "a", range(3)), write(tmp_path / "b", range(3, 5))]
    merge(parts, tmp_path / "merged", limits=limits)
    videos = sorted((tmp_path / "merged" / "videos").rglob("*.mp4"))
    assert [video.stat().st_nlink for video in videos] == [2, 2]


def test_merge_refuses_unlike_datasets(tmp_path):
    parts = [write(tmp_path / "a", range(1), 16), write(tmp_path / "b", range(1), 32)]
    sentence = f"{parts[1]} has other features than {parts[0]} (observation.images.ego); merge datasets that"
    with pytest.raises(ValueError, match=re.escape(sentence)):
        merge(parts, tmp_path / "merged")
    with pytest.raises(ValueError, match="nothing to merge"):
        merge([], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


@pytest.mark.parametrize(
    ("options", "differing"),
    [({"subtasks": True}, "language_persistent"), ({"privileged": False}, "captured, intercept.position, ")],
)
def test_merge_refuses_datasets_of_other_options_and_names_the_columns(tmp_path, options, differing):
    plain, other = write(tmp_path / "a", range(1), None), write(tmp_path / "b", range(1), None, **options)
    for parts in ([plain, other], [other, plain]):
        with pytest.raises(ValueError, match=re.escape(f"has other features than {parts[0]} ({differing}")):
            merge(parts, tmp_path / "merged")


def test_merge_refuses_versions_of_the_benchmark_unless_asked(tmp_path):
    old, new = tmp_path / "old", write(tmp_path / "new", range(1))
    made = varied_episode(1)
    write_episodes(old, [dataclasses.replace(made, meta=dataclasses.replace(made.meta, benchmark="v0"))])
    sentence = f"{old} has benchmark 'v0', {new} has benchmark '{BENCHMARK.version}'; merge datasets of one version"
    with pytest.raises(MixedError, match=re.escape(sentence)):
        merge([old, new], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()
    assert merge([old, new], tmp_path / "merged", allow_version_mismatch=True).benchmark == f"v0, {BENCHMARK.version}"


def test_missed_slots_are_drawn_again(tmp_path):
    manifest = generate(plan(miss_every=4, seed=1), tmp_path / "d", record=recorder.record)
    assert manifest.episodes == 10
    assert len(set(manifest.seeds)) == 10
    assert {seed % REDRAW_STRIDE for seed in manifest.seeds} == set(range(1, 11))
    assert sorted(manifest.seeds)[-2:] == [4 + REDRAW_STRIDE, 8 + REDRAW_STRIDE]
    assert manifest.yields == {"tried": 12, "kept": 10, "failed": 0, "missed": 2, "rejected": 0}


def test_corrupt_recordings_are_rejected_and_drawn_again(tmp_path):
    manifest = generate(plan(), tmp_path / "d", record=recorder.record_with_nan)
    assert manifest.yields == {"tried": 11, "kept": 10, "failed": 0, "missed": 0, "rejected": 1}
    assert 3 not in manifest.seeds
    assert 3 + REDRAW_STRIDE in manifest.seeds


def test_an_impossible_recipe_ends_with_a_sentence(tmp_path):
    with pytest.raises(GenerationError, match=f"failed {MAX_DRAWS} times on each of 3 slots, the first of seed 0"):
        generate(plan(hopeless=True), tmp_path / "d", record=recorder.record)
    assert not (tmp_path / "d").exists()


def test_a_recorder_that_gives_other_seeds_is_caught(tmp_path):
    def wrong(recipe, seeds):
        yield from recorder.record(recipe, [seed + 1 for seed in seeds])

    with pytest.raises(GenerationError, match="seed 3, which was not asked for"):
        generate(plan(), tmp_path / "d", record=wrong)


@pytest.mark.slow
def test_a_dead_worker_is_replaced(tmp_path):
    marker = plan(name=str(tmp_path / "marker"))
    generate(marker, tmp_path / "died", record=recorder.record_and_die_once, workers=2)
    assert (tmp_path / "marker").exists()
    generate(marker, tmp_path / "lived", record=recorder.record_and_die_once)
    assert same(tmp_path / "died", tmp_path / "lived")


def test_workers_that_keep_dying_end_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "STARTS", 1)
    with pytest.raises(GenerationError, match="died 1 times with 4 shards to go"):
        generate(plan(), tmp_path / "d", record=recorder.record_and_die, workers=2)
    assert not (tmp_path / "d").exists()


def test_done_already(reference):
    before = hash_files(reference)
    generate(plan(), reference, record=recorder.record_and_die)
    assert hash_files(reference) == before


def test_another_dataset_is_left_alone(reference, tmp_path):
    before = hash_files(reference)
    with pytest.raises(FileExistsError, match=r"another dataset .other episodes, shard_episodes, name"):
        generate(plan(shard_episodes=2, episodes=3, name="x"), reference, record=recorder.record)
    assert hash_files(reference) == before
    (tmp_path / "precious").mkdir()
    with pytest.raises(FileExistsError, match="no dataset of ours"):
        generate(plan(), tmp_path / "precious", record=recorder.record)


def test_unfinished_work_of_another_plan_is_left_alone(tmp_path):
    with pytest.raises(GenerationError):
        generate(plan(hopeless=True), tmp_path / "d", record=recorder.record)
    with pytest.raises(FileExistsError, match=r"unfinished work of another dataset .other hopeless"):
        generate(plan(), tmp_path / "d", record=recorder.record)


def test_progress_counts_episodes(tmp_path):
    seen: list[int] = []
    generate(plan(), tmp_path / "d", record=recorder.record, progress=seen.append)
    assert seen == [*range(1, 11), 10]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "number of episodes is 0"),
        ({"episodes": -3}, "number of episodes is -3"),
        ({"seed": -1}, "seed is -1"),
        ({"image_size": 33}, "image size is 33"),
        ({"image_size": 8}, "image size is 8"),
    ],
)
def test_impossible_plans_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        plan(**change)


def test_full_disk_leaves_no_dataset_and_the_next_run_goes_on(reference, tmp_path, monkeypatch):
    adds = itertools.count()
    add = DatasetWriter.add

    def add_until_full(self, episode):
        if next(adds) == 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        add(self, episode)

    monkeypatch.setattr(DatasetWriter, "add", add_until_full)
    with pytest.raises(OSError, match="No space left"):
        generate(plan(), tmp_path / "d", record=recorder.record)
    assert not (tmp_path / "d").exists()
    assert [path.name for path in (tmp_path / "d.partial").iterdir() if "shard" in path.name] == ["shard-000000"]
    generate(plan(), tmp_path / "d", record=recorder.record)
    assert same(reference, tmp_path / "d")


def test_recipe_is_in_the_manifest(reference):
    assert Manifest.read(reference).provenance["recipe"] == json.loads(json.dumps(FakeRecipe().stored()))
