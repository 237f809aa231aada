"""The architecture page agrees with the code: rooms, picture, public imports."""

from __future__ import annotations

import importlib
import re
from itertools import pairwise

import pytest

from docs.scripts import rooms_diagram
from docs.scripts.layered_layout import Layout, reachable, transitive_reduction
from tests.rooms import ROOMS, room_imports

PAGE = rooms_diagram.PAGE.read_text()
PUBLIC = dict(re.findall(r"^\| `(dynahoi_lerobot[\w.]+)` \| (.+) \|$", PAGE, re.MULTILINE))
BRANCHING = {"a": set(), "b": {"a"}, "c": {"a", "b"}, "d": {"a", "c"}, "e": {"a"}}


def test_every_room_has_a_paragraph_in_the_order_of_imports():
    assert tuple(rooms_diagram.captions(PAGE)) == ROOMS


def test_the_picture_shows_the_imports_of_today():
    drawn = rooms_diagram.DRAWING.read_text()
    assert drawn == rooms_diagram.draw(PAGE), "run: uv run python -m docs.scripts.rooms_diagram"


def test_the_picture_has_a_box_for_every_room_and_an_arrow_for_every_import_that_no_other_implies():
    drawn = rooms_diagram.draw(PAGE)
    assert re.findall(r'class="name"[^>]*>(\w+)<', drawn) == list(ROOMS)
    assert drawn.count("marker-end") == sum(map(len, transitive_reduction(room_imports()).values()))


def test_arrows_that_are_left_out_follow_from_the_others():
    links = room_imports()
    fewest = transitive_reduction(links)
    assert all(fewest[room] <= links[room] for room in ROOMS), "arrows are imports"
    assert {room: reachable(fewest, room) for room in ROOMS} == {room: reachable(links, room) for room in ROOMS}
    assert transitive_reduction(BRANCHING) == {"a": set(), "b": {"a"}, "c": {"b"}, "d": {"c"}, "e": {"a"}}


@pytest.mark.parametrize("links", [BRANCHING, room_imports()], ids=["branching", "rooms"])
def test_boxes_of_a_row_do_not_overlap_and_links_lead_one_row_down_at_a_time(links: dict[str, set[str]]):
    layout = Layout.of(transitive_reduction(links), lambda a, b: 10.0)
    rows: dict[int, list[float]] = {}
    for node, row in layout.row.items():
        rows.setdefault(row, []).append(layout.place[node])
    assert all(b - a > 10.0 - 1e-6 for places in rows.values() for a, b in pairwise(sorted(places)))
    assert all(layout.row[a] == layout.row[b] + 1 for chain in layout.chains for a, b in pairwise(chain))


def test_there_are_public_imports():
    assert len(PUBLIC) > 10


@pytest.mark.parametrize("module", PUBLIC)
def test_public_names_can_be_imported(module: str):
    names = re.findall(r"`(\w+)`", PUBLIC[module])
    assert names
    assert not [name for name in names if not hasattr(importlib.import_module(module), name)]
