from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.dataset.codecs.base import Encoding
from dynahoi_lerobot.dataset.manifest import Manifest, hash_files
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import VideoWriter, decode
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.verify.checks.base import CHECKS, stratified
from dynahoi_lerobot.verify.runner import verify
from tests.dataset.episodes import varied_episode, write
from tests.generate import recorder
from tests.generate.recorder import FakeRecipe

DATA = "data/chunk-000/file-000.parquet"
ROWS = "meta/episodes/chunk-000/file-000.parquet"
VIDEO = "videos/observation.images.ego/chunk-000/file-{}.mp4"


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """Six episodes in two video files."""
    root = tmp_path_factory.mktemp("sound") / "d"
    generate(GenerationPlan(FakeRecipe(image_size=32), 6, shard_episodes=3), root, record=recorder.record)
    return root


@pytest.fixture
def damaged(sound, tmp_path) -> Path:
    return shutil.copytree(sound, tmp_path / "d")


def sign(root: Path) -> None:
    """Let the manifest promise what is there, as a careful forger would, so that the hashes agree."""
    replace(Manifest.read(root), files=hash_files(root)).write(root)


def edit_json(root: Path, name: str, change: Callable[[dict], object]) -> None:
    content = json.loads((root / name).read_text())
    change(content)
    (root / name).write_text(json.dumps(content))


def edit_cell(root: Path, name: str, column: str, row: int, change: Callable) -> None:
    """Change one cell of a table."""
    table = pq.read_table(root / name)
    cells = table[column].to_pylist()
    cells[row] = change(cells[row])
    position = table.schema.get_field_index(column)
    field = table.schema.field(position)
    pq.write_table(table.set_column(position, field, pa.array(cells, field.type)), root / name)


def cell(name: str, column: str, row: int, change: Callable) -> Callable[[Path], None]:
    return lambda root: edit_cell(root, name, column, row, change)


def entry(name: str, change: Callable[[dict], object]) -> Callable[[Path], None]:
    return lambda root: edit_json(root, name, change)


def drop_row(root: Path, name: str, row: int) -> None:
    table = pq.read_table(root / name)
    pq.write_table(table.filter(pc.not_equal(pa.array(range(len(table))), row)), root / name)


def rewrite_video(root: Path, number: str, frames: Callable[[list], list], fps: int = 20) -> None:
    path = root / VIDEO.format(number)
    pictures = frames(list(decode(path)))
    path.unlink()
    writer = VideoWriter(path, 32, fps, Encoding())
    writer.write(np.stack(pictures))
    writer.close()


def truncate_video(root: Path) -> None:
    path = root / VIDEO.format("000")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def swap_videos(root: Path) -> None:
    first, second = root / VIDEO.format("000"), root / VIDEO.format("001")
    spare = first.with_name("spare")
    first.rename(spare)
    second.rename(first)
    spare.rename(second)


def exchange_frames(root: Path) -> None:
    """Two episodes' pictures change places; the number of frames stays."""
    rewrite_video(root, "000", lambda pictures: pictures[::-1])


def nudge(value: list[float]) -> list[float]:
    return [value[0] + 0.01, *value[1:]]


DAMAGES: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "truncated video": (truncate_video, "videos", "file-000.mp4 cannot be read as a video"),
    "swapped videos": (swap_videos, "videos", "file-000.mp4 holds 72 frames; its episodes have 63"),
    "exchanged frames": (exchange_frames, "pictures", "ego of episode 0 does not show what its statistics were taken"),
    "frames missing in a video": (
        lambda root: rewrite_video(root, "001", lambda pictures: pictures[:-2]),
        "videos", "file-001.mp4 holds 70 frames; its episodes have 72",
    ),
    "video at another rate": (
        lambda root: rewrite_video(root, "001", lambda pictures: pictures, 25), "videos", "file-001.mp4 has (height",
    ),
    "no key frame at a start": (
        lambda root: rewrite_video(root, "000", lambda pictures: pictures),
        "videos", "has no key frame at frame 41, where an episode begins",
    ),
    "missing video": (lambda root: (root / VIDEO.format("001")).unlink(), "videos", "file-001.mp4 cannot be read"),
    "missing data file": (lambda root: (root / DATA).unlink(), "counts", "the data files have 0"),
    "missing frame": (lambda root: drop_row(root, DATA, 30), "indices", "episode 1 has 20 frames in a row"),
    "missing episode row": (lambda root: drop_row(root, ROWS, 5), "counts", "the episode table has 5"),
    "edited action": (
        cell(DATA, "action", 25, nudge), "statistics", "episode 1: action/",
    ),
    "edited target": (
        cell(DATA, "target.velocity", 3, nudge), "statistics", "episode 0: target.velocity/",
    ),
    "wrong fps": (
        entry("meta/info.json", lambda info: info.update(fps=30)), "schema", "fps is 30; it is 20",
    ),
    "wrong feature name": (
        entry("meta/info.json", lambda info: info["features"]["action"]["names"].reverse()),
        "schema", "feature action is",
    ),
    "wrong total": (
        entry("meta/info.json", lambda info: info.update(total_frames=1)),
        "counts", "info.json says 1 frames, the data files have 135",
    ),
    "stale statistics": (
        entry("meta/stats.json", lambda stats: stats["action"]["q99"].__setitem__(4, 9.0)),
        "statistics", "meta/stats.json: action/q99 is",
    ),
    "stale picture statistics": (
        entry("meta/stats.json", lambda s: s["observation.images.ego"].update(std=[[[1]]] * 3)),
        "statistics", "meta/stats.json: observation.images.ego/std is",
    ),
    "stale episode statistics": (
        cell(ROWS, "stats/observation.state/max", 2, nudge),
        "statistics", "episode 2: observation.state/max is",
    ),
    "stale picture counts": (
        cell(ROWS, "stats/histogram_of:observation.images.ego", 2, lambda counts: [counts[0] + 900, *counts[1:]]),
        "statistics", "episode 2: observation.images.ego/",
    ),
    "stale histogram": (
        entry(
            "meta/histograms.json", lambda shown: shown["action"]["palm_x"]["counts"].__setitem__(0, 7)
        ),
        "statistics", "meta/histograms.json does not count",
    ),
    "duplicate seed": (
        cell(ROWS, "seed", 3, lambda _: 2), "duplicates", "episodes 2 and 3 have the same seed, 2",
    ),
    "edited seed": (
        cell(ROWS, "seed", 3, lambda _: 99), "duplicates", "episode 3 has seed 99; the manifest",
    ),
    "wrong index": (
        cell(DATA, "index", 50, lambda _: 7), "indices", "episode 2, frame 9: index is 7; it is 50",
    ),
    "wrong frame index": (
        cell(DATA, "frame_index", 21, lambda _: 5), "indices", "frame 1: frame_index is 5; it is 1",
    ),
    "wrong episode index": (
        cell(ROWS, "episode_index", 4, lambda _: 6), "indices", "row 4 of the episode table is",
    ),
    "wrong span": (
        cell(ROWS, "dataset_to_index", 1, lambda x: x + 1), "indices", "episode 1 spans frames",
    ),
    "wrong timestamp": (
        cell(DATA, "timestamp", 2, lambda _: 0.07), "timestamps", "is 0.0700 s; at 20 Hz",
    ),
    "wrong video range": (
        cell(ROWS, "videos/observation.images.ego/from_timestamp", 2, lambda x: x + 0.05),
        "videos", "is said to hold episode 2 from 2.10",
    ),
    "wrong task index": (
        cell(DATA, "task_index", 0, lambda _: 1), "tasks", "episode 0 has frames of task 1",
    ),
    "task out of range": (
        cell(DATA, "task_index", 0, lambda _: 8), "tasks", "episode 0 has frames of task 8 (None",
    ),
    "edited instruction": (
        cell(ROWS, "task", 1, lambda _: "Wave."), "tasks", "its instruction is 'Wave.'",
    ),
    "NaN": (
        cell(DATA, "observation.state", 44, lambda x: [float("nan"), *x[1:]]),
        "plausibility", "episode 2: observation.state is not finite at frame 3",
    ),
    "jump": (
        cell(DATA, "observation.state", 44, lambda x: [x[0] + 0.5, *x[1:]]),
        "plausibility", "episode 2: observation.state jumps by 0.5",
    ),
    "beyond limits": (
        cell(DATA, "action", 44, lambda x: [*x[:17], 4.0]), "plausibility", "rad are possible",
    ),
    "wrong window": (
        cell(ROWS, "window_frames", 0, lambda _: 3),
        "episode_columns", "episode 0: window_frames is 3, 8 frames observe",
    ),
    "wrong length": (
        cell(ROWS, "length_frames", 0, lambda _: 3), "episode_columns", "length_frames is 3",
    ),
    "wrong intercept": (
        cell(ROWS, "intercept_frame", 0, lambda _: 3), "episode_columns", "intercept_frame is 3",
    ),
    "broken parameters": (
        cell(ROWS, "parameters", 0, lambda _: "{"), "episode_columns", "parameters is no JSON",
    ),
    "failed episode": (
        cell(ROWS, "success", 0, lambda _: False), "episode_columns", "success is False",
    ),
}  # fmt: skip


def test_intact_datasets_have_no_findings(sound, tmp_path):
    assert verify(sound, decoded=None) == []
    assert verify(write(tmp_path / "images", range(3), encoding=Encoding("images"))) == []
    assert verify(write(tmp_path / "blind", range(3), None)) == []
    parts = [write(tmp_path / "a", range(2)), write(tmp_path / "b", range(2, 4))]
    merge(parts, tmp_path / "merged")
    assert verify(tmp_path / "merged") == []


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_named(damaged, name):
    damage, check, sentence = DAMAGES[name]
    damage(damaged)
    changed = {str(finding) for finding in verify(damaged) if finding.check == "files"}
    assert changed, "the hashes alone give it away"
    sign(damaged)
    findings = verify(damaged, decoded=None)
    assert any(finding.check == check and sentence in finding.message for finding in findings), findings
    assert not [finding for finding in findings if finding.check == "files"]


def test_an_episode_recorded_twice_is_named(tmp_path):
    generate(GenerationPlan(FakeRecipe(), 4), tmp_path / "d", record=recorder.record_one_twice)
    assert [str(finding) for finding in verify(tmp_path / "d")] == [
        "duplicates: episodes 1 and 2 have the same trajectory"
    ]


def test_every_check_is_needed_by_some_damage():
    assert {check for _, check, _ in DAMAGES.values()} | {"files"} == set(CHECKS.names())


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda root: (root / "meta/manifest.json").unlink(), "meta/manifest.json is missing"),
        (lambda root: (root / "meta/tasks.parquet").unlink(), "meta/tasks.parquet is missing"),
        (lambda root: (root / "data/chunk-000/file-001.parquet").touch(), "file-001.parquet is not in the manifest"),
        (entry("meta/manifest.json", lambda m: m.update(episodes=7)), "says 7 episodes"),
        (entry("meta/manifest.json", lambda m: m.update(format=9)), "unknown format"),
        (
            entry("meta/manifest.json", lambda m: m["files"].update({DATA: "0"})),
            "the manifest says 0",
        ),
        (lambda root: (root / "meta/info.json").write_text("{"), "info.json cannot be read (JSONDecodeError"),
    ],
)
def test_damage_to_files_is_named(damaged, damage, sentence):
    damage(damaged)
    assert any(sentence in finding.message for finding in verify(damaged)), verify(damaged)


def test_many_findings_are_shortened(damaged):
    table = pq.read_table(damaged / DATA)
    position = table.schema.get_field_index("timestamp")
    late = pc.add(table["timestamp"], pa.scalar(0.01, pa.float32()))
    pq.write_table(table.set_column(position, table.schema.field(position), late), damaged / DATA)
    found = [finding.message for finding in verify(damaged) if finding.check == "timestamps"]
    assert len(found) == 6
    assert found[-1] == "and 1 more"


def test_replay_compares_states_and_pictures(sound):
    def honest(meta, actions):
        episode = varied_episode(meta.seed)
        np.testing.assert_array_equal(actions, episode.action)
        return episode.state, episode.images

    def other_states(meta, actions):
        states, pictures = honest(meta, actions)
        states = states.copy()
        states[7:] += 1e-3
        return states, pictures

    def other_pictures(meta, actions):
        states, pictures = honest(meta, actions)
        return states, {"ego": pictures["ego"][::-1].copy() // 2}

    def shorter(meta, actions):
        return honest(meta, actions)[0][:-1], {}

    assert verify(sound, resimulate=honest, replayed=6) == []
    for wrong, sentence in (
        (other_states, "episode 0 replays to other states from frame 7 on"),
        (other_pictures, "replays to another picture of ego"),
        (shorter, "replays to states of shape (19, 18)"),
    ):
        assert sentence in str(verify(sound, resimulate=wrong, replayed=1)[0])


def test_samples_take_turns_among_kinds():
    rows = [{"motion": kind} for kind in "aaaaaaaabbc"]
    assert stratified(rows, 3) == [0, 8, 10]
    assert stratified(rows, 5) == [0, 7, 8, 9, 10]
    assert stratified(rows, 6) == [0, 4, 7, 8, 9, 10]
    assert all(len(set(stratified(rows, count))) == count for count in range(12))
    assert stratified(rows, 100) == list(range(11))


def test_verify_needs_a_dataset(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no LeRobot dataset"):
        verify(tmp_path)


def test_progress(sound):
    seen: list[int] = []
    verify(sound, progress=seen.append)
    assert seen == [1, 2, 3, 4, 5, 6]
    assert len(Store(sound).rows) == 6
