"""A tiny run of `dynahoi pretrain`: it logs, leaves an eye, and resumes after a kill."""

import json
import re
import shutil
from pathlib import Path

import pytest
import torch
import yaml
from lerobot_policy_obact.encoders import Eye
from lerobot_policy_obact.eye import pretraining
from lerobot_policy_obact.eye.run_folder import LOG, STATE, RunFolder
from safetensors.torch import load_file
from torch.utils.data import DataLoader

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.pretrain.recipe import read_recipe
from tests.tools import dynahoi

TINY_EYE = {"channels": 8, "fovea": 12}
BATCH = 4
UPDATES = 7
SAVE_EVERY = 3


def tiny_recipe(folder: Path, **changes: object) -> Path:
    """Write a recipe of seven updates, saved after the third, the sixth and the last."""
    recipe = {
        "out": str(folder / "eye"),
        "episodes": {"image_size": 32},
        "n_episodes": 2,
        "batch_size": BATCH,
        "images": BATCH * UPDATES,
        "save_every": SAVE_EVERY,
        "eye": TINY_EYE,
    }
    path = folder / "recipe.yaml"
    path.write_text(yaml.safe_dump(recipe | changes))
    return path


def log(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / LOG).read_text().splitlines()]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pretrain")
    assert main(["pretrain", "--recipe", str(tiny_recipe(folder))]) == 0
    return folder / "eye"


def kill_at(monkeypatch: pytest.MonkeyPatch, update: int) -> None:
    """Let the run stop in the middle of an update, counted from where it begins."""
    loss = pretraining.sighting_loss
    calls = []

    def killed(*args):
        calls.append(args)
        if len(calls) > update:
            raise KeyboardInterrupt
        return loss(*args)

    monkeypatch.setattr(pretraining, "sighting_loss", killed)


def test_an_eye_is_pretrained_and_a_policy_starts_from_it(finished: Path):
    eye = Eye(**TINY_EYE, weights=str(finished / pretraining.WEIGHTS))
    eye.load_pretrained()
    assert [line["images"] for line in log(finished)] == [12, 24, 28]
    minutes = [line["processor_minutes"] for line in log(finished)]
    assert 0 < minutes[0] <= minutes[1] <= minutes[2]


def test_a_run_that_was_killed_twice_ends_as_one_that_was_not(finished, tmp_path, monkeypatch):
    words = ["pretrain", "--recipe", str(tiny_recipe(tmp_path))]
    for update in (5, 2):  # two updates after the first save, then one before the second
        with monkeypatch.context() as patch:
            kill_at(patch, update)
            assert "; run the same command to resume" in dynahoi(*words, code=130).err
        assert [line["images"] for line in log(tmp_path / "eye")] == [BATCH * SAVE_EVERY]
        assert not (tmp_path / "eye" / pretraining.WEIGHTS).exists()
    assert main(words) == 0
    assert [line["loss"] for line in log(tmp_path / "eye")] == [
        line["loss"] for line in log(finished)
    ]
    weights = load_file(tmp_path / "eye" / pretraining.WEIGHTS)
    for name, tensor in load_file(finished / pretraining.WEIGHTS).items():
        torch.testing.assert_close(weights[name], tensor, rtol=0, atol=0, msg=name)


def test_several_processes_render_the_same_images_after_a_resume(tmp_path: Path):
    recipe = read_recipe(tiny_recipe(tmp_path, n_episodes=4), workers=2)
    whole = list(DataLoader(pretraining.RenderedImages(recipe, 0), None, num_workers=2))
    rest = list(DataLoader(pretraining.RenderedImages(recipe, SAVE_EVERY), None, num_workers=2))
    assert len(whole) == UPDATES
    for one, other in zip(whole[SAVE_EVERY:], rest, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)
    assert len({place.numpy().tobytes() for _, place in whole}) == UPDATES, (
        "no two batches are the same"
    )


def test_a_setting_overrides_the_recipe(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["pretrain", "--recipe", str(tiny_recipe(tmp_path)), "--set"]
    assert main([*words, f"images={BATCH}"]) == 0
    assert json.loads(capsys.readouterr().out)["images"] == BATCH
    assert main([*words, "imagess=10"]) == 2
    assert (
        "unknown field of the recipe 'imagess' (did you mean 'images'?)" in capsys.readouterr().err
    )
    for wrong in ("images", "images={"):
        assert main([*words, wrong]) == 2
        assert f"must be KEY=VALUE, the value as YAML, got {wrong!r}" in capsys.readouterr().err


def test_a_finished_run_is_not_trained_again(finished, monkeypatch, capsys):
    kill_at(monkeypatch, 0)
    before = (finished / pretraining.WEIGHTS).read_bytes()
    assert main(["pretrain", "--recipe", str(finished.parent / "recipe.yaml")]) == 0
    assert "already trained on all 28 images" in capsys.readouterr().out
    assert (finished / pretraining.WEIGHTS).read_bytes() == before


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("save_every", 0),
        ("batch_size", 0),
        ("images", 3),
        ("randomized_share", 1.5),
        ("camera", "front"),
    ],
)
def test_a_wrong_recipe_is_refused_in_a_sentence(name: str, value: object, tmp_path: Path, capsys):
    assert main(["pretrain", "--recipe", str(tiny_recipe(tmp_path, **{name: value}))]) == 2
    assert re.search(f"{name} must be .*, got {value}\n", capsys.readouterr().err)
    assert not (tmp_path / "eye").exists()


def test_a_loss_that_is_not_finite_ends_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pretraining, "sighting_loss", lambda *_: torch.tensor([float("nan")]))
    assert main(["pretrain", "--recipe", str(tiny_recipe(tmp_path))]) == 1
    assert (
        "the loss of update 0 is nan; lower learning_rate; the last save is in"
        in capsys.readouterr().err
    )


def test_a_folder_goes_back_to_its_last_whole_save(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = RunFolder(tmp_path / "run", {})
    folder.log({"of": "a run that was killed before it saved"})
    assert folder.restore() is None
    folder.log({"step": 1})
    folder.save({"step": 1})
    folder.log({"step": 2})

    def half(state: dict, path: Path) -> None:
        path.write_bytes(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", half)
    with pytest.raises(KeyboardInterrupt):
        folder.save({"step": 2})
    restored = folder.restore()
    assert restored is not None
    assert restored["step"] == 1
    assert log(tmp_path / "run") == [{"step": 1}]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"updates": UPDATES + 1}, f"it says {UPDATES + 1} updates"),
        ({"processor_s": float("nan")}, "in nan s; it must be"),
        ({"weights": {}}, "Missing key"),
    ],
)
def test_a_saved_state_that_no_run_has_is_refused(
    change: dict, told: str, finished, tmp_path, capsys
):
    recipe = tiny_recipe(tmp_path)
    shutil.copytree(finished, tmp_path / "eye")
    state = torch.load(tmp_path / "eye" / STATE, weights_only=True)
    torch.save(state | change, tmp_path / "eye" / STATE)
    assert main(["pretrain", "--recipe", str(recipe)]) == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'eye' / STATE} cannot be read" in said
    assert told in said
