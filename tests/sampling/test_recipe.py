"""Recipes: what is wrong is told in one sentence; which code decides what they give."""

import re
import shutil
from pathlib import Path

import pytest

import dynahoi_lerobot
from dynahoi_lerobot.core.protocols import ControlClass
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.rollout.recording import Recording, load_recording
from dynahoi_lerobot.sampling.fingerprint import (
    deciding_sources,
    extension_fingerprint,
    hash_sources,
)
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from tests.test_imports import ROOMS, imports

BAD_VALUES = [
    {"split": "trian"},
    {"protocol": "look"},
    {"control_class": "slow"},
    {"motions": ("lateral", "latteral")},
    {"views": ("side", "side")},
    {"motions": ("lob", "constant", "lob")},
    {"objects": ("cup", "cup")},
    {"image_size": 8},
    {"perturbed_share": 1.5},
    {"actor": "somebody"},
    {"motions": ("helix",)},
    {"objects": ("jack",), "split": "test"},
    {"split": "ood_motion", "motions": ("lateral",)},
    {"split": "test", "path_speed": 1.6},
    {"split": "twins", "path_speed": 2},
    {"split": "twins", "protocol": "occluded"},
    {"split": "twins", "motions": ("lob",)},
    {"environment_state": "eye", "image_size": 64},
]
BAD_FILES: dict[str, tuple[str, str]] = {
    "an unknown field": ("splt: train\n", "splt"),
    "an unknown name": ("motions: [latteral]\n", "latteral"),
    "a wrong type": ("image_size: large\n", "large"),
    "a text for a list": ("motions: lateral\n", "motions must be a list, got 'lateral'"),
    "null in a list": ("motions: [null]\n", "motions.0 must be a valid string, got None"),
    "a flag for a number": ("path_speed: true\n", "path_speed must be a valid number, got True"),
    "no mapping": ("false", ""),
}


@pytest.mark.parametrize("values", BAD_VALUES, ids=str)
def test_a_bad_value_is_named_in_one_sentence(values: dict):
    *_, value = values.values()
    with pytest.raises(
        ValueError, match=re.escape(str(value[-1] if isinstance(value, tuple) else value))
    ) as error:
        Recording.of(**values)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("limits", "message"),
    [((-0.8, 20, 0), "palm_speed_m_s must be above 0, got -0.8"), ((1, 20, -1), "latency_ms")],
)
def test_a_control_class_that_no_hand_could_keep_is_refused(limits, message):
    with pytest.raises(ValueError, match=message):
        ControlClass("swift", *limits)


def test_a_motion_without_a_fitting_object_is_refused():
    with pytest.raises(ValueError, match="motion 'ramp' takes none of the objects egg, ring"):
        sample_specs(Recipe(motions=("ramp",), objects=("egg", "ring")), [0])


def test_kinds_that_no_object_of_the_recipe_can_perform_are_left_out():
    names = Recipe(objects=("egg",)).motion_names
    assert "constant" in names
    assert not {"ramp", "bounce", "struck"} & set(names)


def test_a_recipe_file_gives_the_recipe(tmp_path: Path):
    path = tmp_path / "recipe.yaml"
    path.write_text(
        "split: val\nmotions: [lateral, ramp]\nimage_size: 64\nperturbed_share: 25e-2\n"
    )
    assert load_recording(path) == Recording.of(
        split="val", motions=("lateral", "ramp"), image_size=64, perturbed_share=0.25
    )
    path.write_text("# everything as usual\n")
    assert load_recording(path) == Recording()


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_named_in_one_line_with_what_is_wrong(tmp_path: Path, name: str):
    path = tmp_path / "recipe.yaml"
    text, wrong = BAD_FILES[name]
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(wrong)) as error:
        load_recording(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path):
    for path in (tmp_path / "absent.yaml", tmp_path):
        with pytest.raises(ValueError, match=re.escape(str(path))):
            load_recording(path)


PACKAGE = Path(dynahoi_lerobot.__file__).parent
READING = ("cli", "doctor", "encode", "env", "evaluate", "hub", "metrics", "play", "pretrain")
READING += ("report", "verify", "vlm")
"""Rooms that decide no byte of a dataset; of ``generate`` some modules do."""


def test_an_edit_of_a_deciding_source_changes_the_fingerprint_and_one_elsewhere_does_not(
    tmp_path: Path,
):
    sources = deciding_sources(PACKAGE)
    rooms = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in sources}
    assert rooms == {"__init__", *ROOMS} - {*READING}
    unused = shutil.ignore_patterns("__pycache__")
    copy = shutil.copytree(PACKAGE, tmp_path / "package", ignore=unused)
    before = hash_sources(PACKAGE)
    (copy / "generate" / "executors.py").write_text("# edited")
    assert hash_sources(copy) == before
    (copy / "generate" / "plan.py").write_text("# edited")
    assert hash_sources(copy) != before


def test_deciding_sources_import_only_deciding_sources():
    files = [path.relative_to(PACKAGE.parent).with_suffix("") for path in deciding_sources(PACKAGE)]
    deciding = {".".join(path.parts).removesuffix(".__init__") for path in files}
    assert len(deciding) > 80
    known = deciding | {"dynahoi_lerobot.generate"}
    for module, imported in imports():
        if module in deciding and imported.startswith("dynahoi_lerobot."):
            assert imported in known, module


def test_code_of_others_counts_and_ours_is_not_counted_twice():
    class Theirs:
        pass

    assert extension_fingerprint([OBJECTS["ball"]]) == ""
    assert len(extension_fingerprint([OBJECTS["ball"], Theirs])) == 16
