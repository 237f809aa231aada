"""The dataset card: metadata that the Hub reads, counts, every column, histograms."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynahoi_lerobot.core.conventions import HAND_NAMES
from dynahoi_lerobot.core.features import episode_features
from dynahoi_lerobot.dataset.card import histogram_svg
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store


@pytest.fixture(scope="module")
def card(dataset: Path) -> str:
    return (dataset / "README.md").read_text()


def test_its_metadata_are_lerobots_and_more(card: str):
    from lerobot.datasets.utils import create_lerobot_dataset_card

    theirs = create_lerobot_dataset_card(license="apache-2.0").data.to_dict()
    ours = yaml.safe_load(card.split("---")[1])
    assert set(theirs["tags"]) <= set(ours["tags"])
    assert {name: ours[name] for name in theirs if name != "tags"} == {n: v for n, v in theirs.items() if n != "tags"}
    assert ours["size_categories"] == ["n<1K"]


def test_it_counts_and_describes_what_is_there(dataset: Path, card: str):
    manifest = Manifest.read(dataset)
    assert f"{manifest.episodes} episodes ({manifest.frames} frames" in card
    assert "| constant | 6 | 6 |" in card
    assert "| control mode | `joints`, an action of 18 numbers |" in card
    assert "{{" not in card.replace("{{DynaHOI}", "")
    for key in [*Store(dataset).features, *(feature.key for feature in episode_features())]:
        assert f"| `{key}` |" in card


def test_every_dimension_has_a_panel_and_its_tallest_bar_fills_it(dataset: Path):
    panels = ET.fromstring((dataset / "assets/action.svg").read_text()).findall("{http://www.w3.org/2000/svg}g")
    assert tuple(panel[0].text for panel in panels) == HAND_NAMES
    assert all("V16.0h" in panel[1].attrib["d"] for panel in panels)
    assert "V16.0h" in histogram_svg(np.full((3, 1), 2.0), ["still"])
