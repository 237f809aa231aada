"""The page as a reader's browser would take it: complete, self-contained, and safe with hostile names."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.gif import write_gif
from dynahoi_lerobot.evaluate.results import ResultsError
from dynahoi_lerobot.evaluate.table import MAIN_COLUMNS, heading
from dynahoi_lerobot.report import clips, page, render_report
from dynahoi_lerobot.report.figures.base import FIGURES
from tests.report.example_runs import example_run

HOSTILE = "<script>alert('x')</script><img src=https://evil.example/a.png onerror=alert(1)>\"&{{ 7*7 }}"


class Page(HTMLParser):
    """Tags with attributes, the text of every table cell row by row, and all visible text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in self._open:
            while self._open.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if "style" in self._open or "script" in self._open:
            return
        self.text += data
        if "td" in self._open or "th" in self._open:
            self.rows[-1][-1] += data if "small" not in self._open else " " + data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def quick():
    """Draw two figures only; each figure has its own tests."""
    patch = pytest.MonkeyPatch()
    patch.setattr(page, "in_order", lambda: [FIGURES["stages"], FIGURES["obs-frames"]])
    yield
    patch.undo()


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, quick: None) -> Path:
    root = tmp_path_factory.mktemp("runs")
    example_run(root / "expert", "expert", 1.0, 22)
    example_run(root / "hostile", HOSTILE, 0.4, 22, command=f"dynahoi evaluate --policy '{HOSTILE}'", seed_note="<b>")
    for index in range(2):
        write_gif(root / "expert" / f"clip_{index}.gif", np.full((3, 8, 8, 3), 90 * index, np.uint8))
    return root


@pytest.fixture(scope="module")
def html(root: Path) -> str:
    out = render_report([root / "expert", root / "hostile"], root / "report.html")
    assert out == root / "report.html"
    return out.read_text()


@pytest.fixture(scope="module")
def parsed(html: str) -> Page:
    return Page(html)


def test_every_evaluation_is_a_row_with_its_values(parsed: Page):
    head = next(row for row in parsed.rows if row[0] == "policy")
    assert head == ["policy", *map(heading, MAIN_COLUMNS)]
    expert = next(row for row in parsed.rows if row[0] == "expert")
    assert expert[1] == "100.0 [85.1, 100.0]"
    assert len(expert) == len(head)


def test_the_parts_of_the_page_are_there_and_linked(parsed: Page):
    sections = {attributes["id"] for attributes in parsed.all("section")}
    assert sections == {"results", "comparison", "stages", "clips", "kinds", "runs", "glossary"}
    assert {a["href"] for a in parsed.all("a")} == {f"#{name}" for name in sections}
    assert any(row[0] == "lob" for row in parsed.rows)
    assert any(row[0] == "Q_smooth_18d" and "Legacy smoothness" in row[-1] for row in parsed.rows)


def test_command_and_fingerprint_of_every_row_are_exact(parsed: Page):
    assert "dynahoi evaluate --policy expert --split test_small" in parsed.text
    assert f"dynahoi evaluate --policy '{HOSTILE}'" in parsed.text
    assert parsed.text.count("f00dcafe") == 2


def test_hostile_names_are_text(parsed: Page):
    assert HOSTILE in parsed.text
    assert len(parsed.all("script")) == 1
    assert not any(name.startswith("on") for _, attributes in parsed.tags for name in attributes)
    assert not parsed.all("b")


def test_nothing_is_fetched_from_outside(html: str, parsed: Page):
    for _, attributes in parsed.tags:
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            assert attributes.get(name, "#").startswith(("#", "data:image/"))
    assert {"link", "iframe", "object", "embed", "base"}.isdisjoint(tag for tag, _ in parsed.tags)
    style = re.search(r"<style>(.*?)</style>", html, re.S)[1]
    assert "url(" not in style
    assert "@import" not in style
    policy = next(m["content"] for m in parsed.all("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")


def test_clips_are_embedded(parsed: Page):
    gifs = [image for image in parsed.all("img") if image["src"].startswith("data:image/gif;base64,")]
    assert [image["alt"] for image in gifs] == ["clip_0", "clip_1"]
    assert all(image["alt"] for image in parsed.all("img"))


def test_clips_beyond_the_limit_are_counted(root: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(clips, "MOST_CLIPS", 1)
    text = Page(render_report([root / "expert"], root / "short.html").read_text()).text
    assert "1 more in the folder" in text


def test_a_folder_as_goal_gets_the_page(root: Path):
    assert render_report([root / "expert"], root / "expert") == root / "expert" / "report.html"


def test_the_page_is_the_same_every_time(root: Path, html: str):
    again = render_report([root / "expert", root / "hostile"], root / "again.html")
    assert again.read_text() == html


def test_no_folder_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="at least one result folder"):
        render_report([], tmp_path)


def test_a_damaged_folder_leaves_no_page(root: Path, tmp_path: Path):
    with pytest.raises(ResultsError, match="no result folder"):
        render_report([root / "expert", tmp_path / "nowhere"], tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()
