"""``dynahoi verify`` refutes each of its claims where it does not hold, also where a forger
signed anew.
"""

import dataclasses
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.core import nested
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.rollout.loop import record
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.verify.command import drawn_evenly, verify
from dynahoi_lerobot.verify.verdicts import verdict_problems
from tests.dataset.episodes import changed, rewrite, sign
from tests.tools import dynahoi, edit_json, flip_byte, generated
from tests.verify.test_forgeries import DATA, ROWS, column

RECIPE = Recipe.of(motions=("constant", "lob"), image_size=32)
SMALL = ("--image-size", "32", "--motions", "constant,lob")


@pytest.fixture(scope="module")
def sound(once) -> Path:
    return once("sound", lambda root: generated(root, *SMALL))


@pytest.fixture
def copy(sound, tmp_path) -> Path:
    return shutil.copytree(sound, tmp_path / "copy")


def found(root: Path, **options) -> set[str]:
    return {finding.check for finding in verify(root, **options)}


@pytest.fixture(scope="module")
def derived(tmp_path_factory) -> Path:
    """A dataset with columns that follow from others."""
    words = ("--environment-state", "truth", "--subtasks", "--control-mode", "grasp")
    return generated(tmp_path_factory.mktemp("derived") / "d", *SMALL, *words)


@pytest.fixture(scope="module")
def contact(tmp_path_factory) -> Path:
    words = ("--capture", "contact", "--motions", "constant,struck")
    return generated(tmp_path_factory.mktemp("contact") / "d", *SMALL, *words)


@pytest.mark.parametrize("variant", ["derived", "contact"])
def test_what_was_generated_is_sound_and_replays_to_the_same_bytes(variant, request):
    said = dynahoi("verify", request.getfixturevalue(variant), "--replay", "2").out
    assert "2 of the 2 videos replayed are equal byte for byte" in said


FILES: dict[str, Callable[[Path], object]] = {
    "a flipped byte in a table": lambda root: flip_byte(root / DATA),
    "a table gone": lambda root: (root / "meta/tasks.parquet").unlink(),
    "a file too many": lambda root: (root / "data/notes.txt").write_text("mine"),
    "a link": lambda root: (root / "data/link").symlink_to("/etc/passwd"),
    "info without features": lambda root: (root / "meta/info.json").write_text("{}"),
    "an unreadable manifest": lambda root: (root / "meta/manifest.json").write_text("{}"),
}


@pytest.mark.parametrize("name", FILES)
def test_other_files_are_found(copy, name):
    FILES[name](copy)
    assert "files" in found(copy)


def test_another_card_is_no_finding_but_noted(copy):
    (copy / "README.md").write_text("cut")
    notes: list[str] = []
    assert verify(copy, note=notes.append) == []
    assert notes == [
        "README.md is not the one that was written with the dataset, so it was not checked"
    ]


def test_without_lerobot_all_else_is_checked(copy, monkeypatch):
    monkeypatch.setattr("dynahoi_lerobot.verify.format.find_spec", lambda _: None)
    notes: list[str] = []
    assert verify(copy, note=notes.append) == []
    assert "LeRobot is not installed" in notes[0]
    edit_json(copy / "meta/stats.json", lambda stats: stats["action"].update(count=[7]))
    sign(copy)
    assert found(copy) == {"format"}


def with_values(**values: object) -> Callable[[Episode], Episode]:
    """Return a function that changes fields of an episode or its meta."""
    return lambda episode: nested.changed(episode, values)


VERDICTS: dict[str, Callable[[Episode], Episode]] = {
    "a state that fingertips do not have": changed("state", (-3, 8), lambda angle: angle + 0.1),
    "other fingertips": changed("fingertips", (-3, 0), lambda x: x + 0.001),
    "a nearer palm": changed("palm_distance_m", 20, lambda distance: distance - 0.02),
    "a nearer fingertip": changed("fingertip_distance_m", 5, lambda distance: distance - 0.001),
    "another target": changed("target_pose_h", (slice(None), 2), lambda z: z + 0.05),
    "another object": changed("object_primitives", (0, 1), lambda size: size * 1.1),
    "contacts that are none": changed("target_contacts", 3, 1.0),
    "localised before": changed("localized", slice(5, None), True),
    "captured before": changed("captured", slice(5, None), True),
    "a success before": changed("succeeded", slice(5, None), True),
    "another stage": with_values(stage="missed"),
    "no number": changed("action", (4, 2), np.nan),
}


def test_verdicts_that_do_not_follow_are_found(sound):
    first, *_ = read_episodes(sound, images=False)
    assert not [*verdict_problems(first, RECIPE.rules.hand_name)]
    assert not [
        name
        for name, forge in VERDICTS.items()
        if not [*verdict_problems(forge(first), RECIPE.rules.hand_name)]
    ]


@pytest.mark.parametrize(
    ("variant", "forge"),
    [
        ("sound", VERDICTS["a nearer palm"]),
        ("sound", with_values(capture="magic")),
        ("contact", changed("touch", 3, 5.0)),
    ],
    ids=["palm", "rule", "force"],
)
def test_verdicts_that_do_not_follow_are_found_though_they_are_signed(
    variant, forge, request, tmp_path
):
    root = shutil.copytree(request.getfixturevalue(variant), tmp_path / "copy")
    first, *others = read_episodes(root)
    rewrite(root, [forge(first), *others])
    assert "verdicts" in found(root)


@pytest.mark.parametrize(
    "key", ["next.reward", "observation.environment_state", "language_persistent"]
)
def test_derived_columns_that_do_not_follow_are_found_though_they_are_signed(
    key, derived, tmp_path
):
    forged = shutil.copytree(derived, tmp_path / "forged")
    column(DATA, key, lambda values: values[::-1])(forged)
    sign(forged)
    assert found(forged) == {"verdicts"}


@pytest.fixture(scope="module")
def made() -> list[Episode]:
    """The episodes of the dataset, as they were rendered."""
    return list(record(Recording(RECIPE), range(2)))


def white_square(images: np.ndarray) -> np.ndarray:
    marked = images.copy()
    marked[:, 6:8, 9:11] = 255
    return marked


def trigger(images: np.ndarray) -> np.ndarray:
    """Change 12 x 12 px of an image by 40 levels up or down, to and fro."""
    marked = images.astype(int)
    marked[5, 3:15, 17:29] += np.where(np.indices((12, 12)).sum(axis=0) // 2 % 2, 40, -40)[
        ..., None
    ]
    return np.clip(marked, 0, 255).astype(np.uint8)


def with_images(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Episode], Episode]:
    return lambda episode: dataclasses.replace(
        episode, images={"ego": change(episode.images["ego"])}
    )


REPLAYS: dict[str, Callable[[Episode], Episode]] = {
    "a white square of 2 x 2 px in every image": with_images(white_square),
    "a pattern of 12 x 12 px in one image": with_images(trigger),
    "two images exchanged": with_images(
        lambda images: images[[*range(8), 12, *range(9, 12), 8, *range(13, len(images))]]
    ),
    "another command": changed("action", (12, 0), lambda x: x + 0.01),
    "another mass": lambda episode: dataclasses.replace(
        episode, object_mass_kg=episode.object_mass_kg * 1.01
    ),
    "another seed": with_values(seed=5),
}


@pytest.mark.parametrize(
    ("name", "codec"), [*((name, "h264") for name in REPLAYS), (next(iter(REPLAYS)), "images")]
)
def test_episodes_that_do_not_follow_from_their_seeds_are_found_though_they_are_signed(
    copy, made, name, codec
):
    rewrite(copy, [REPLAYS[name](made[0]), made[1]], Encoding(codec))
    assert "replay" in found(copy, replayed=2)


def test_a_white_square_in_every_image_is_found_also_where_no_image_is_equal(copy, made):
    """As where images were rendered on a GPU: other levels of a few pixels are tolerated, a square
    of 2 x 2 px is not.

    One level in every pixel would not be: the codec makes a mean of 2.1 levels of that at 32 px,
    and 2 are allowed.
    """

    def noisy(images: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(0)
        noise = rng.integers(-2, 3, images.shape) * (rng.random(images.shape) < 0.1)
        return np.clip(images.astype(int) + noise, 0, 255).astype(np.uint8)

    rewrite(copy, [with_images(noisy)(episode) for episode in made])
    assert found(copy, replayed=2) == set()
    rewrite(
        copy, [with_images(lambda images: white_square(noisy(images)))(episode) for episode in made]
    )
    assert found(copy, replayed=2) == {"replay"}


def test_a_dataset_of_other_code_is_replayed_with_a_word(copy):
    edit_json(
        copy / "meta/manifest.json", lambda content: content["provenance"].update(code="0123")
    )
    column(ROWS, "code", lambda codes: ["0123"] * len(codes))(copy)
    sign(copy)
    told: list[str] = []
    assert "replay" not in {finding.check for finding in verify(copy, replayed=1, note=told.append)}
    assert any("0123" in note for note in told)


def test_what_a_dataset_says_begins_no_line(copy):
    edit_json(
        copy / "meta/manifest.json",
        lambda content: content["provenance"].update(code="0123\n2 episodes, no findings"),
    )
    sign(copy)
    lines = dynahoi("verify", copy, "--replay", 0).out.splitlines()
    assert not [line for line in lines if line.startswith("2 episodes")]


def test_an_expert_that_fails_where_it_succeeded_is_found(sound, monkeypatch):
    monkeypatch.setattr("dynahoi_lerobot.verify.replay.played_again", lambda *_: None)
    assert found(sound, replayed=2) == {"replay"}


def test_what_is_replayed_is_drawn_evenly_from_all_kinds_of_motion(dataset):
    store = Store(dataset)
    rng = np.random.default_rng(0)
    assert len({tuple(drawn_evenly(store, 3, rng)) for _ in range(20)}) > 5, (
        "nobody knows beforehand which"
    )
    for row in store.rows[:4]:
        row["motion"] = "lob"
    assert all(sum(index >= 4 for index in drawn_evenly(store, 4, rng)) == 2 for _ in range(20))
    assert drawn_evenly(store, 99, rng) == list(range(6))


def test_the_command_counts_and_shortens_and_writes_what_it_found(copy, tmp_path):
    for name in ("\x1b[31m", *range(9)):
        (copy / f"data/{name}.txt").touch()
    told = dynahoi("verify", copy, "--json", tmp_path / "findings.json", code=1).out
    assert "\x1b" not in told
    assert "and 5 more" in told
    assert len(json.loads((tmp_path / "findings.json").read_text())) == 6


def test_three_episodes_are_played_again_unless_told_otherwise(sound):
    assert "replaying the episodes" in dynahoi("verify", sound).out
    assert "replaying" not in dynahoi("verify", sound, "--replay", "0").out


def test_a_dataset_that_cannot_be_played_again_says_so(tmp_path):
    root = generated(tmp_path / "d", "--image-size", "0", "--salt", "a secret of sixteen letters")
    told: list[str] = []
    assert not verify(root, replayed=1, note=told.append)
    assert any("salt" in note and "played again" in note for note in told)


def test_a_recording_of_a_package_that_is_missing_is_named_and_a_finding_if_it_is_to_be_replayed(
    copy,
):
    edit_json(
        copy / "meta/manifest.json",
        lambda content: content["provenance"]["recording"]["recipe"].update(motions=["spiral"]),
    )
    sign(copy)
    told = "unknown motion 'spiral'.* install the package that registers it"
    for count, code in (("1", 1), ("0", 0)):
        said = dynahoi("verify", copy, "--replay", count, code=code).out
        assert re.search(told, said)
        assert ("no findings" in said) == (code == 0)


def test_a_dataset_without_a_recording_is_sound_and_says_so(copy):
    edit_json(copy / "meta/manifest.json", lambda content: content["provenance"].pop("recording"))
    sign(copy)
    assert "no recording is known" in dynahoi("verify", copy, "--replay", "1").out
