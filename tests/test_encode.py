"""``dynahoi encode``: columns of sightings instead of images, and everything else as it was."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets.dataset_tools import delete_episodes, modify_tasks
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from dynahoi_lerobot.core.image_sensor import image_sensor
from dynahoi_lerobot.dataset import episode_column, frame_column, read_episodes
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.encode import SIGHTINGS_PREFIX, encode
from dynahoi_lerobot.evaluate.checkpoint_rules import trained_for
from dynahoi_lerobot.world.detector import Detector
from tests.conftest import Once
from tests.tools import dynahoi, flip_byte, generated, lerobot_train


@pytest.fixture(scope="module")
def encoded(dataset: Path, once: Once) -> Path:
    def make(out: Path) -> Path:
        dynahoi("encode", dataset, out)
        return out

    return once("encoded", make)


def test_a_column_holds_what_the_sensor_sees_in_each_image_and_the_one_before(
    dataset: Path, encoded: Path
):
    sensor = image_sensor("eye")("ego")
    found = frame_column(encoded, SIGHTINGS_PREFIX + "ego")
    first = 0
    for episode in read_episodes(dataset, [0, 1]):
        images = episode.images["ego"]
        for frame in (0, 1, len(images) - 1):
            before = images[max(frame - 1, 0)]
            seen = sensor.see(images[frame][None], before[None])[0]
            np.testing.assert_allclose(found[first + frame], seen, atol=1e-4)
        first += len(images)


def test_what_policies_must_not_see_is_read_back(dataset: Path, encoded: Path):
    features = Store(dataset).privileged.features
    assert "target_path" in [feature.key for feature in features]
    for feature in features:
        read = frame_column if feature.per == "frame" else episode_column
        for before, after in zip(
            read(dataset, feature.key), read(encoded, feature.key), strict=True
        ):
            np.testing.assert_array_equal(after, before)
    for key in ("observation.state", "action", "target.pose"):
        np.testing.assert_array_equal(frame_column(encoded, key), frame_column(dataset, key))


def test_columns_that_nobody_learns_from_are_left_out(tmp_path: Path):
    """They slow down LeRobot's loader; `dynahoi verify` does without them."""
    root = generated(tmp_path / "images", "--image-size=96", "--capture=contact", episodes=2)
    dynahoi("encode", root, tmp_path / "encoded")
    before, after = (Store(one).features.keys() for one in (root, tmp_path / "encoded"))
    assert before - after == {
        "observation.images.ego",
        "observation.touch",
        "next.reward",
        "next.done",
    }
    assert after - before == {SIGHTINGS_PREFIX + "ego"}
    dynahoi("verify", tmp_path / "encoded")


def test_lerobot_s_tools_edit_it(encoded: Path, tmp_path: Path):
    source = LeRobotDataset("local/encoded", root=encoded)
    kept = delete_episodes(source, [0], output_dir=tmp_path / "kept")
    assert kept.meta.total_episodes == source.meta.total_episodes - 1


def test_one_without_manifest_is_said_to_be_of_another_tool(dataset: Path, tmp_path: Path):
    delete_episodes(LeRobotDataset("local/d", root=dataset), [0], output_dir=tmp_path / "fewer")
    said = dynahoi("encode", tmp_path / "fewer", tmp_path / "out", code=2).err
    assert "fewer was written by another tool, such as lerobot-edit-dataset" in said


def test_it_is_signed_anew(dataset: Path, encoded: Path):
    before = Manifest.read(dataset)
    after = Manifest.read(encoded)
    assert after.provenance["encoded"] == {"sensor": "eye", "from": before.digest}
    assert (after.seeds, after.benchmark) == (before.seeds, before.benchmark)


def test_what_has_changed_since_it_was_signed_is_not_signed_anew(dataset: Path, tmp_path: Path):
    root = shutil.copytree(dataset, tmp_path / "d")
    modify_tasks(LeRobotDataset("local/d", root=root), new_task="Catch it.")
    said = dynahoi("encode", root, tmp_path / "out", code=2).err
    assert "data/chunk-000/file-000.parquet has changed: its sha256 is not the manifest's" in said
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_verify_checks_what_is_left_of_it(encoded: Path, tmp_path: Path, capsys):
    dynahoi("verify", encoded)
    assert "its images were encoded" in capsys.readouterr().out
    (line,) = [x for x in (encoded / "README.md").read_text().split("\n") if SIGHTINGS_PREFIX in x]
    assert "log" in line, "its card names the numbers"
    root = shutil.copytree(encoded, tmp_path / "changed")
    flip_byte(next(root.glob("data/*/*.parquet")))
    dynahoi("verify", root, code=1)


def test_a_part_of_it_is_copied_and_its_card_names_the_numbers(encoded: Path, tmp_path: Path):
    out = tmp_path / "part"
    dynahoi("filter", encoded, "--out", out, "--drop", "0")
    found = frame_column(out, SIGHTINGS_PREFIX + "ego")
    np.testing.assert_array_equal(
        found, frame_column(encoded, SIGHTINGS_PREFIX + "ego")[-len(found) :]
    )
    (line,) = [
        one for one in (out / "README.md").read_text().split("\n") if SIGHTINGS_PREFIX in one
    ]
    assert "log" in line


@pytest.fixture(scope="module")
def with_state(dataset: Path, once: Once) -> Path:
    def make(out: Path) -> Path:
        dynahoi("encode", dataset, out, "--environment-state")
        return out

    return once("encoded_state", make)


def test_the_environment_state_is_what_environments_show_of_the_same_images(
    dataset: Path, with_state: Path
):
    found = frame_column(with_state, "observation.environment_state")
    states = []
    poses, intrinsics = (
        episode_column(dataset, f"ego_{name}") for name in ("camera", "intrinsics")
    )
    for i, episode in enumerate(read_episodes(dataset, [0, 1])):
        shown = Detector(image_sensor("eye")("ego"), 2, poses[i], intrinsics[i])
        for frame, image in enumerate(episode.images["ego"]):
            images = np.stack([np.zeros_like(image), image])
            palm = np.stack([np.zeros(3), episode.state[frame, :3]])
            states.append(shown.see(images, palm, np.array([1]), np.full(2, frame))[1])
    np.testing.assert_allclose(found[: len(states)], states, atol=2e-4)
    assert np.ptp(found[:, :12], axis=0).min() > 0.01, "targets move"


def test_act_learns_from_it_and_its_checkpoint_asks_environments_for_the_same(tmp_path: Path):
    root = generated(tmp_path / "images", "--image-size=96", "--control-mode=grasp")
    with_state = tmp_path / "encoded"
    encode(root, with_state, environment_state=True)
    dynahoi("verify", with_state)
    small = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "chunk_size": 4, "device": "cpu"}
    recipe = Path(__file__).parents[1] / "recipes/train/act.yaml"
    given = {"config_path": recipe, "env": None}
    act = lerobot_train(with_state, tmp_path / "act", small, **given)
    assert trained_for(act)["environment_state"] == "eye"
    film, results = tmp_path / "film.gif", tmp_path / "results"
    dynahoi("view", "--motion=planar", "--policy", act, "--out", film)
    dynahoi("evaluate", "--policy", act, "--episodes=1", "--out", results)
    dynahoi("view", "--results", results, "--image-size=32", "--out", film)


def test_a_column_that_is_there_is_not_added_again(with_state: Path, tmp_path: Path, monkeypatch):
    """It says so before it has encoded all images."""
    root = generated(tmp_path / "images", "--image-size=96", "--environment-state=eye")
    monkeypatch.setattr("dynahoi_lerobot.encode._sightings", None)
    said = dynahoi("encode", root, tmp_path / "out", "--environment-state", code=2).err
    assert "already has observation.environment_state; leave --environment-state out" in said


def test_an_interruption_does_not_promise_to_resume(dataset: Path, tmp_path: Path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("dynahoi_lerobot.encode._sightings", stop)
    assert (
        dynahoi("encode", dataset, tmp_path / "out", code=130).err
        == "dynahoi encode: interrupted\n"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--sensor", "ear"], "unknown image sensor 'ear'"),
        ([], "choose a new folder"),
    ],
    ids=["sensor", "folder"],
)
def test_what_cannot_be_encoded_is_refused_in_a_sentence(
    words: list[str], said: str, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    out = tmp_path / "out"
    if not words:
        out.mkdir()
    dynahoi("encode", dataset, out, *words, code=2)
    assert said in capsys.readouterr().err
    assert not [*tmp_path.glob("out/*")]
