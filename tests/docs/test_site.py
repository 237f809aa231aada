"""The site's own code: a page for everything registered, links that hold, every docstring, no requests elsewhere."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest
from sphinx.ext.napoleon import GoogleDocstring

from docs.extensions import api_pages
from docs.extensions.gallery import pages as gallery
from docs.extensions.gallery import scores
from docs.extensions.gallery.ranges import described_attributes, parameter_ranges
from docs.extensions.gallery.theory_tests import named_tests, sentence, sweeping_tests
from docs.extensions.markdown import map_links
from docs.extensions.mathml import mathml
from docs.extensions.no_requests import requests_of
from docs.extensions.public_names import wrapped_definitions
from docs.extensions.repository_files import DOCS, linked_files, relinked
from docs.extensions.repository_files import pages as file_pages
from dynahoi_lerobot.cli.listing import LISTS
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS
from tests.docs.documents import ROOT, Page

BENCHMARK_PAGE = Page.read(DOCS / "benchmark.md")
SECTIONS = gallery.sections()
GENERATED = {**gallery.pages(), **file_pages()}
ENTRIES = [(section, name) for section, entries in SECTIONS.items() for name in entries]


@pytest.mark.parametrize("section", ["motions", "objects", "hands", "metrics"])
def test_everything_registered_has_a_page(section: str):
    assert set(SECTIONS[section]) == {row["name"] for row in LISTS[section]()}


@pytest.mark.parametrize(("section", "name"), ENTRIES)
def test_a_page_shows_a_picture_of_its_own_and_the_section_leads_to_it(section: str, name: str):
    page = SECTIONS[section][name]
    assert page.startswith(f"# {name}\n")
    assert re.search(rf"!\[[^\]]*{name}[^\]]*\]\({name}\.(gif|png|svg)\)|no picture", page)
    assert f"({name}.md)" in GENERATED[f"gallery/{section}/index.md"]


@pytest.mark.parametrize(("section", "name"), ENTRIES)
def test_links_of_generated_pages_lead_to_pages(section: str, name: str):
    page = Page(DOCS / "gallery" / section / f"{name}.md", SECTIONS[section][name])
    targets = [(page.path.parent / target).resolve() for _, target in page.links if target.endswith(".md")]
    assert targets
    assert not [
        target for target in targets if not target.is_file() and target.relative_to(DOCS).as_posix() not in GENERATED
    ]


@pytest.mark.parametrize("kind", MOTIONS.names())
def test_every_parameter_of_a_motion_is_explained(kind: str):
    rows = parameter_ranges(kind)
    assert rows
    assert all(meaning for _, meaning, _ in rows)


def test_ranges_are_those_that_the_docstring_states():
    ranges = {name: spans for name, _, spans in parameter_ranges("horizontal_circle")}
    ((low, high),) = ranges["radius_m"]
    assert 0.1 <= low < 0.11
    assert 0.29 < high <= 0.3
    assert len(ranges["center"]) == 3


def test_attributes_are_those_of_the_class_and_of_its_bases():
    found = described_attributes(MOTIONS["helix"])
    assert found["climb_m_s"] == "vertical speed, signed."
    assert found["radius_m"] == "R."


def test_theory_tests_are_found_through_helpers_constants_and_names():
    pendulums = named_tests("motions", {"planar", "PlanarPendulum", "SuspendedMotion"})
    (names,) = pendulums.values()
    assert "test_small_swings_have_the_small_period" in names  # by the name in quotes
    assert "test_the_string_keeps_its_length" in names  # by the base class, in a list of kinds
    (bounces,) = named_tests("motions", {"Bounce"}).values()
    assert "test_bounces_return_the_stated_share_of_the_speed" in bounces  # by a helper
    assert named_tests("motions", {"no such class"}) == {}
    (derivatives,) = sweeping_tests("motions").values()
    assert "test_velocity_and_acceleration_are_the_exact_derivatives" in derivatives
    assert sentence("test_a_b") == "a b"


@pytest.mark.parametrize("stratum", [*CATEGORIES, *BENCHMARK.splits["test"].objects])
def test_scores_of_a_category_or_an_object_are_those_of_the_benchmarks_page(stratum: str):
    header, *rows = scores.of_stratum(stratum)
    assert header == ["", "S_loc %, `standard`", "S_loc %, `late`"]
    assert rows[0] == ["`expert`", "100", "100"]
    pursuit = next(row for row in rows if row[0] == "`pursuit`")
    assert f"| {pursuit[1]} |" in BENCHMARK_PAGE.text


@pytest.mark.parametrize("name", ["capsule", "opposed"])
def test_scores_of_a_hand_are_not_those_of_an_object_of_that_name(name: str):
    header, expert, *others = scores.of_stratum(f"{name} hand")
    assert header == ["", "S_joint %, `standard`"]
    assert expert == ["`expert`", "100"]
    assert [row[0] for row in others] == ["`constant_velocity`"]
    assert "| `expert` | 100 |" in SECTIONS["hands"][name]


@pytest.mark.parametrize("name", RANDOMIZATIONS)
def test_a_page_of_the_appearance_says_what_it_costs_tracker(name: str):
    header, *rows = scores.of_stratum(name)
    assert header == ["", "S_loc %, `standard`"]
    assert [row[0] for row in rows] == ["Tracker, one camera", "Tracker, two cameras"]
    assert f"| {rows[1][0]} | {rows[1][1]} |" in SECTIONS["appearances"][name]


def test_pages_of_views_say_who_reads_them():
    pages = SECTIONS["views"]
    assert all(f"| {scores.of_stratum(name)[1][1]} |" in pages[name] for name in ("ego", "side"))
    assert "No checkpoint that ships reads it." in pages["side_depth"]


def test_scores_of_a_metric_have_the_control_class_of_their_column():
    header, expert, *_ = scores.of_metric("S_intercept")
    assert header == ["", "S_intercept %, `standard`", "S_intercept %, `late`"]
    assert expert[0] == "`expert`"
    assert scores.of_metric("S_loc")[0] == ["", "S_loc %, `standard`", "S_loc %, `late`", "S_loc %, `unlimited`"]
    assert scores.of_metric("Q_line") == []


def test_the_benchmarks_page_lists_its_tasks():
    rows = re.findall(r"^\| `(\w+)` \| ((?:`\w+`(?:, )?)+) \|", BENCHMARK_PAGE.text, re.MULTILINE)
    listed = {category: re.findall(r"`(\w+)`", kinds) for category, kinds in rows if category in CATEGORIES}
    kinds = BENCHMARK.splits["test"].motions
    assert listed == {category: [k for k in kinds if MOTIONS[k].category == category] for category in CATEGORIES}


def test_links_outside_of_code_are_mapped():
    text = "[a](b.md) ![c](d.png) [e](https://f) [g](#h)\n\n```\n[i](j.md)\n```\n\n[k](l.md)"
    mapped = "[a](B.MD) ![c](D.PNG) [e](https://f) [g](#h)\n\n```\n[i](j.md)\n```\n\n[k](L.MD)"
    assert map_links(text, str.upper) == mapped


def test_links_to_files_lead_to_their_pages():
    page = DOCS / "guide" / "train.md"
    text = "[a](../../CONTRIBUTING.md#x) [b](../zoo.md) [c](../../recipes) [d](../../dynahoi_lerobot/captures)"
    expected = "[a](../files/CONTRIBUTING.md#x) [b](../zoo.md) [c](../files/recipes.md)"
    assert relinked(text, page, page) == f"{expected} [d](../api/dynahoi_lerobot.captures.rst)"


def test_a_link_that_leads_nowhere_is_refused_by_name():
    page = DOCS / "benchmark.md"
    with pytest.raises(FileNotFoundError, match=r"docs/benchmark.md links to nothing.py"):
        relinked("[a](nothing.py)", page, page)


def test_files_that_pages_link_to_have_pages_with_their_text():
    assert ROOT / "CONTRIBUTING.md" in linked_files()
    assert "literalinclude" in GENERATED["files/recipes/lean.yaml.md"]
    assert "(train/standard.yaml.md)" in GENERATED["files/recipes/train.md"]
    card = GENERATED["files/checkpoints/tracker_standard/README.md"]
    assert card.startswith("---\norphan: true\n---\n")
    assert "library_name" not in card


def test_the_reference_looks_for_every_public_docstring():
    names = api_pages.missing(set())
    assert {"dynahoi_lerobot.metrics.s_loc.s_loc", "dynahoi_lerobot.episode.Episode.reward"} <= set(names)
    assert api_pages.missing(set(names)) == []
    assert not [name for name in names if "._" in name]


@pytest.mark.parametrize("package", api_pages.PACKAGES)
def test_modules_of_the_reference_are_the_packages_own(package: str):
    spec = importlib.util.find_spec(package)
    assert spec
    assert Path(spec.origin or "").parent == api_pages.PACKAGES[package]
    assert all(api_pages.source_of(name).is_file() for group in api_pages.modules(package).values() for name in group)


def test_docstrings_behind_decorators_are_in_the_reference():
    module = "dynahoi_lerobot.metrics.s_loc"
    text = wrapped_definitions(module, api_pages.source_of(module))
    assert ".. py:function:: s_loc(episode: Episode) -> bool" in text
    assert "Localisation success: the palm centre" in text
    module = "dynahoi_lerobot.sampling.fingerprint"  # whose cached functions autodoc sees by itself
    assert wrapped_definitions(module, api_pages.source_of(module)) == ""


@pytest.mark.parametrize(
    "text",
    [
        '<script src="https://cdn.example/x.js"></script>',
        '<img src="//cdn.example/x.png">',
        '<link rel="stylesheet" href="https://fonts.example/x.css">',
        '<img srcset="https://cdn.example/x.png 2x">',
        '<div style="background: url(https://cdn.example/x.png)">',
        '<style>@import "https://fonts.example/x.css";</style>',
    ],
)
def test_requests_to_other_hosts_are_found(text: str):
    assert len(requests_of(text)) == 1


def test_requests_of_style_sheets_are_found():
    assert requests_of("body { background: url('//x.example/y.png') }", ".css") == ["//x.example/y.png"]
    assert requests_of("body { background: url(y.png) }", ".css") == []


def test_links_that_people_follow_are_no_requests():
    assert requests_of('<a href="https://x.example">x</a><link rel="next" href="https://x"><img src="a.png">') == []
    assert requests_of("<pre>url(https://cdn.example/x.png)</pre>") == []


def test_formulas_are_mathml():
    text = mathml(r"Q = \frac{1}{1 + \sigma_d / \mu_d}", "block")
    assert text.startswith("<math")
    assert "<mfrac>" in text
    assert 'display="block"' in text


@pytest.mark.parametrize("what", ["attribute", "data", "property"])
def test_a_colon_in_an_attributes_first_line_stays_in_its_text(what: str):
    lines = ["Rows: coefficients of 1, s, s^2."]
    api_pages.keep_colons(what, lines)
    parsed = str(GoogleDocstring(lines, what=what, name="ROWS"))
    assert " ".join(parsed.split()) == ".. Rows: coefficients of 1, s, s^2."
