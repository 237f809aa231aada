"""The dataset card: LeRobot's template with every field filled, and pictures of the histograms."""

from __future__ import annotations

import importlib.util
import json
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from dynahoi_lerobot.core.features import episode_features
from dynahoi_lerobot.dataset.card import readme
from dynahoi_lerobot.dataset.card.figures import histogram_svg
from dynahoi_lerobot.dataset.manifest import Manifest, file_problems
from dynahoi_lerobot.dataset.store import Store
from tests.dataset.episodes import write

PICTURES = ("assets/action.svg", "assets/observation.state.svg")


@pytest.fixture(scope="module")
def card(dataset: Path) -> str:
    return (dataset / "README.md").read_text()


def test_the_template_is_lerobots():
    spec = importlib.util.find_spec("lerobot")
    assert spec is not None
    assert spec.submodule_search_locations
    theirs = Path(spec.submodule_search_locations[0]) / "datasets/card_template.md"
    ours = Path(readme.__file__).with_name("templates") / "lerobot.md"
    assert ours.read_text() == theirs.read_text()


def test_its_metadata_are_lerobots_and_more(card: str):
    from lerobot.datasets.utils import create_lerobot_dataset_card

    theirs = create_lerobot_dataset_card(license="apache-2.0").data.to_dict()
    ours = yaml.safe_load(card.split("---")[1])
    assert theirs["configs"] == ours["configs"]
    assert set(theirs["tags"]) <= set(ours["tags"])
    assert {name: ours[name] for name in theirs if name != "tags"} == {n: v for n, v in theirs.items() if n != "tags"}
    assert ours["size_categories"] == ["n<1K"]


def test_no_field_is_left_open(card: str):
    assert "[More Information Needed]" not in card
    assert "{{" not in card.replace("{{DynaHOI}", "")


def test_it_counts_and_describes_what_is_there(dataset: Path, card: str):
    manifest = Manifest.read(dataset)
    assert f"{manifest.episodes} episodes ({manifest.frames} frames at 20 Hz)" in card
    assert "| constant | 6 | 6 |" in card
    for key in Store(dataset).features:
        assert f"| `{key}` |" in card
    for feature in episode_features():
        assert f"| `{feature.key}` | {feature.dtype} |" in card


def test_it_names_the_hash_of_all_other_files(dataset: Path, card: str):
    manifest = Manifest.read(dataset)
    others = {name: digest for name, digest in manifest.files.items() if name not in {"README.md", *PICTURES}}
    assert len(others) == len(manifest.files) - 3
    assert f"without this card | {replace(manifest, files=others).digest} |" in card


def test_it_shows_the_provenance(tmp_path: Path):
    write(tmp_path / "whole", range(2))
    bare = Manifest.read(tmp_path / "whole")
    made = replace(bare, provenance={"recipe": {"capture": "attach"}, "code": "abc"}, yields={"tried": 3, "kept": 2})
    readme.finish_with_card(tmp_path / "whole", made)
    text = (tmp_path / "whole/README.md").read_text()
    assert "recipe:\n  capture: attach\n" in text
    assert "| fingerprint of the code | abc |" in text
    assert "| 3, 2, unknown |" in text


def test_every_dimension_has_a_panel_and_the_tallest_bar_fills_it(dataset: Path):
    histograms = json.loads((dataset / "meta/histograms.json").read_text())
    for name, key in zip(PICTURES, ("action", "observation.state"), strict=True):
        picture = ET.fromstring((dataset / name).read_text())
        panels = picture.findall("{http://www.w3.org/2000/svg}g")
        titles = [panel[0].text for panel in panels]
        assert titles == list(histograms[key])
        assert "V16.0h" in panels[0][1].attrib["d"]
    empty = histogram_svg({"<x>": {"min": 0.0, "max": 0.0, "counts": [0, 0]}})
    assert "&lt;x&gt;" in empty
    assert "V76.0h65.00V76.0h65.00" in empty


def test_people_may_edit_their_card_but_not_the_pictures(dataset: Path, tmp_path: Path):
    copy = shutil.copytree(dataset, tmp_path / "copy")
    (copy / "README.md").write_text("mine")
    assert list(file_problems(copy, Manifest.read(copy))) == []
    (copy / PICTURES[0]).write_text("<svg/>")
    (problem,) = file_problems(copy, Manifest.read(copy))
    assert problem.startswith("assets/action.svg has changed")


def test_size_categories_are_the_hubs():
    assert readme._size_category(999) == "n<1K"
    assert readme._size_category(1000) == "1K<n<10K"
    assert readme._size_category(12_345_678) == "10M<n<100M"
    assert readme._size_category(10**9) == "n>100M"
