from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import frame_features
from dynahoi_lerobot.dataset.codecs import Encoding
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.merge import merge
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import VideoWriter, decode
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.generate.pipeline import generate
from dynahoi_lerobot.generate.plan import GenerationPlan
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.replay import simulator
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify import replay_check
from dynahoi_lerobot.verify.checks.base import Finding, stratified
from dynahoi_lerobot.verify.runner import verify
from tests.dataset.episodes import varied_episode, write
from tests.verify.forgery import DATA, ROWS, pa, sign, table, with_column

RECIPE = Recipe(motions=("constant", "struck"), image_size=16, hold_frames=12)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Path:
    """Two simulated episodes, whose pictures are PNG files in the frame table."""
    root = tmp_path_factory.mktemp("simulated") / "d"
    generate(GenerationPlan(RECIPE, 2, encoding=Encoding("images")), root, record=record)
    return root


@pytest.fixture
def replayed(simulated):
    """Returns the findings of a replay whose first episode was changed."""
    honest = simulator(Manifest.read(simulated).provenance["recipe"])

    def run(**changes) -> list[str]:
        def dishonest(seed: int) -> Episode | None:
            made = honest(seed)
            return replace(made, **{name: change(getattr(made, name)) for name, change in changes.items()})

        return [finding.message for finding in verify(simulated, replayed=1, resimulate=dishonest)]

    return run


def test_intact_datasets_have_no_findings(tmp_path):
    assert verify(write(tmp_path / "video", range(6)), decoded=None) == []
    assert verify(write(tmp_path / "images", range(3), encoding=Encoding("images")), decoded=None) == []
    assert verify(write(tmp_path / "blind", range(3), None)) == []
    parts = [write(tmp_path / "a", range(2)), write(tmp_path / "b", range(2, 4))]
    merge(parts, tmp_path / "merged")
    assert verify(tmp_path / "merged") == []


def test_an_episode_recorded_twice_is_named(tmp_path):
    writer = DatasetWriter(tmp_path / "d", frame_features(32))
    for episode in (twin := varied_episode(1), replace(twin, meta=replace(twin.meta, seed=2))):
        writer.add(episode)
    writer.finish()
    assert list(map(str, verify(tmp_path / "d"))) == ["duplicates: episodes 0 and 1 have the same trajectory"]


def test_a_changed_png_picture_is_found_to_the_pixel(simulated, tmp_path):
    root = tmp_path / "d"
    merge([simulated], root, provenance=Manifest.read(simulated).provenance)

    def exchanged(old: pa.Table) -> pa.Table:
        cells = old["observation.images.ego"].to_pylist()
        return with_column(old, "observation.images.ego", pa.array([cells[9], *cells[1:]], old.schema.field(0).type))

    table(DATA, exchanged)(root)
    sign(root)
    assert verify(root, decoded=0) == []
    (finding,) = verify(root)
    assert "ego of episode 0 does not show what its statistics were taken from" in finding.message
    assert "pixels have other levels" in finding.message


def test_many_findings_are_shortened(tmp_path):
    root = write(tmp_path / "d", range(7))
    late = lambda old: with_column(old, "timestamp", pa.array(np.array(old["timestamp"]) + np.float32(0.01)))  # noqa: E731
    table(DATA, late)(root)
    found = [finding.message for finding in verify(root) if finding.check == "timestamps"]
    assert len(found) == 6
    assert found[-1] == "and 2 more"


def test_replay_compares_facts_columns_and_pictures(replayed):
    assert replayed() == []
    (fact,) = replayed(meta=lambda meta: replace(meta, task="Wave."))
    assert "episode 0 replays to task 'Wave.'; stored is" in fact
    (column,) = replayed(target_velocity=lambda v: v + np.where(np.arange(len(v)) == 7, 1e-3, 0)[:, None])
    assert "another target.velocity from frame 7 on, up to 0.001 apart" in column
    assert any("another picture of ego at frame" in said for said in replayed(images=lambda i: {"ego": i["ego"][::-1]}))
    assert any("palm_distance of shape (19,)" in said for said in replayed(palm_distance=lambda values: values[:19]))


def test_a_seed_that_the_expert_does_not_manage_is_named(simulated):
    (finding,) = verify(simulated, replayed=1, resimulate=lambda seed: None)
    assert finding.message == "episode 0: the expert does not manage seed 0"


def test_only_the_same_code_replays(simulated, monkeypatch):
    assert verify(simulated, replayed=2) == []
    monkeypatch.setattr(replay_check, "code_fingerprint", lambda: "other")
    (finding,) = verify(simulated, replayed=2)
    assert "made by other code" in finding.message


def test_the_manifests_digest_does_not_depend_on_layout_and_stands_for_all_files(simulated):
    manifest = Manifest.read(simulated)
    text = (simulated / "meta/manifest.json").read_text()
    assert json.loads(text)["sha256"] == manifest.digest == manifest.sha256
    assert replace(manifest, files={**manifest.files, DATA: "0"}).digest != manifest.digest
    assert replace(manifest, files=dict(reversed(manifest.files.items()))).digest == manifest.digest


def test_snapshots_of_the_hubs_cache_are_no_stray_links(simulated, tmp_path):
    blobs, snapshot = tmp_path / "blobs", tmp_path / "snapshots/abc"
    blobs.mkdir()
    for number, path in enumerate(path for path in simulated.rglob("*") if path.is_file()):
        (blobs / str(number)).write_bytes(path.read_bytes())
        link = snapshot / path.relative_to(simulated)
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(blobs / str(number))
    (snapshot / "README.md").write_text("a card")
    assert verify(snapshot) == []


def test_findings_are_one_printable_line():
    assert str(Finding("tasks", "\x1b[2J\nCatch\u202e")) == "tasks: \\x1b[2J\\nCatch\\u202e"
    assert len(str(Finding("tasks", "x" * 10_000))) == 600


def test_samples_take_turns_among_kinds():
    rows = [{"motion": kind} for kind in "aaaaaaaabbc"]
    assert stratified(rows, 3) == [0, 8, 10]
    assert stratified(rows, 5) == [0, 7, 8, 9, 10]
    assert stratified(rows, 6) == [0, 4, 7, 8, 9, 10]
    assert all(len(set(stratified(rows, count))) == count for count in range(12))
    assert stratified(rows, 100) == list(range(11))


def test_verify_needs_a_dataset(tmp_path):
    with pytest.raises(FileNotFoundError, match="is no LeRobot dataset"):
        verify(tmp_path)


def test_progress(tmp_path):
    seen: list[int] = []
    root = write(tmp_path / "d", range(6))
    verify(root, progress=seen.append)
    assert seen == [1, 2, 3, 4, 5, 6]
    assert len(Store(root).rows) == 6


def test_episode_rows_in_another_type_are_named(tmp_path):
    root = write(tmp_path / "d", range(2))
    table(ROWS, lambda old: with_column(old, "attempts", old["attempts"].cast(pa.int32())))(root)
    assert any("holds attempts as int32; it is int64" in str(finding) for finding in verify(root))


def test_every_swap_of_pictures_in_which_a_small_thing_moves_is_found(tmp_path: Path):
    """A square of 3 px, none of them among those that thinning keeps."""
    slope = np.linspace(60, 160, 128).astype(np.uint8)
    made = np.tile(slope[None, None, :, None], (12, 128, 1, 3))
    for frame in range(12):
        made[frame, 61:64, 10 * frame + 1 : 10 * frame + 4] = 240
    video = VideoWriter(tmp_path / "video.mp4", 128, 20, Encoding())
    video.write(made)
    video.close()
    stored = np.stack(list(decode(tmp_path / "video.mp4")))
    assert not list(replay_check._frames(made, stored))
    for place, shown in itertools.permutations(range(12), 2):
        swapped = stored.copy()
        swapped[place] = stored[shown]
        (problem,) = replay_check._frames(made, swapped)
        assert problem.startswith(f"at frame {place}, ")
        assert problem.endswith(f"it looks like frame {shown}")
