"""The page as a reader's browser would take it: complete, self-contained, and safe with hostile names."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.gif import write_gif
from dynahoi_lerobot.evaluate.results import ResultsError
from dynahoi_lerobot.evaluate.table import MAIN_COLUMNS, Table, heading, metric_cell
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report import figures, page, render_report
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.report.page import clips_of, comparison_tables, glossary, page_content
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


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Draw two figures only; each figure has its own tests."""
    patch = pytest.MonkeyPatch()
    few = [figure for figure in figures.FIGURES if figure.name in ("stages", "obs-frames")]
    patch.setattr(figures, "FIGURES", few)
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


def test_commands_are_exact_and_hostile_names_are_text(parsed: Page):
    assert "dynahoi evaluate --policy expert --split test_small" in parsed.text
    assert f"dynahoi evaluate --policy '{HOSTILE}'" in parsed.text
    assert parsed.text.count("f00dcafe") == 2
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


def test_clips_are_embedded_up_to_a_limit(root: Path, parsed: Page, monkeypatch: pytest.MonkeyPatch):
    gifs = [image for image in parsed.all("img") if image["src"].startswith("data:image/gif;base64,")]
    assert [image["alt"] for image in gifs] == ["clip_0", "clip_1"]
    monkeypatch.setattr(page, "MOST_CLIPS", 1)
    shown, left_out = clips_of(root / "expert")
    assert ([name for name, _ in shown], left_out) == (["clip_0"], 1)


def test_only_gifs_of_the_folder_itself_are_embedded(tmp_path: Path):
    (tmp_path / "secret").write_bytes(b"GIF89a secret")
    folder = tmp_path / "run"
    write_gif(folder / "true\x1b.gif", np.zeros((2, 8, 8, 3), np.uint8))
    (folder / "link.gif").symlink_to(tmp_path / "secret")
    (folder / "text.gif").write_text("no GIF")
    (folder / "folder.gif").mkdir()
    with (folder / "huge.gif").open("wb") as file:
        file.write(b"GIF89a")
        file.truncate(10**8)
    shown, left_out = clips_of(folder)
    assert ([name for name, _ in shown], left_out) == ([r"true\x1b"], 0)


def test_the_page_is_the_same_every_time_and_may_go_into_a_folder(root: Path, html: str):
    assert render_report([root / "expert", root / "hostile"], root / "expert") == root / "expert" / "report.html"
    assert (root / "expert" / "report.html").read_text() == html


def test_no_folder_or_a_damaged_one_leaves_no_page(root: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="at least one result folder"):
        render_report([], tmp_path)
    with pytest.raises(ResultsError, match="no result folder"):
        render_report([root / "expert", tmp_path / "nowhere"], tmp_path / "report.html")
    assert not list(tmp_path.iterdir())


def test_odd_but_honest_values_still_make_a_page(tmp_path: Path):
    odd = {"n_obs_frames": 10**400, "data_fraction": "half", "recipe": 7}
    example_run(tmp_path / "run", "<b>", 0.5, 4, rules={"category": "<b>", "object": ""}, **odd)
    assert "<b>" not in render_report([tmp_path / "run"], tmp_path / "page.html").read_text()


# -- its tables -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    root = tmp_path_factory.mktemp("runs")
    example_run(root / "strong", "strong", 1.0, 24)
    example_run(root / "weak", "weak", 0.1, 24)
    example_run(root / "holder", "holder", 0.5, 24, capture="contact")
    return read_entries([root / "strong", root / "weak", root / "holder"])


@pytest.fixture(scope="module")
def content(entries: list[Entry]) -> dict:
    return page_content(entries)


def column(table: Table, title: str) -> dict:
    place = next(index for index, head in enumerate(table.head) if head.split()[0] == title)
    return {row[0].text: row[place] for row in table.rows}


def test_both_tables_together_hold_every_estimate_once(entries: list[Entry], content: dict):
    tables = content["main_metrics"], content["other_metrics"]
    titles = [head.split()[0] for table in tables for head in table.head]
    assert all(titles.count(name) == 1 for name in METRICS.names())
    assert "S_joint_paper" in [head.split()[0] for head in content["other_metrics"].head]
    for entry in entries:
        for table in tables:
            for name in METRICS.names():
                if any(head.split()[0] == name for head in table.head):
                    cell, wanted = column(table, name)[entry.label], metric_cell(entry.results.summary()[name])
                    assert (cell.text, cell.detail, cell.key) == (wanted.text, wanted.detail, wanted.key)


def test_conditions_are_columns_where_evaluations_differ_and_in_the_caption_where_they_agree(content: dict):
    table = content["main_metrics"]
    assert sorted(cell.text for cell in column(table, "capture").values()) == ["attach", "attach", "contact"]
    assert "split" not in table.head
    assert "split test_small" in table.caption
    assert "n 24" in table.caption


def test_the_best_is_marked_under_equal_conditions_only(entries: list[Entry], content: dict):
    for name in ("S_loc", "E_loc", "R_time"):
        marks = {label: cell.mark for label, cell in column(content["main_metrics"], name).items()}
        assert marks == {"strong": "best", "weak": "", "holder": ""}
    alone = page_content([entry for entry in entries if entry.label != "strong"])["main_metrics"]
    assert not any(cell.mark for row in alone.rows for cell in row)


def test_the_comparison_is_antisymmetric_and_under_equal_conditions(entries: list[Entry]):
    tables = dict(zip(("S_loc", "S_joint", "E_loc", "commands"), comparison_tables(entries), strict=True))
    for name, better in (("S_loc", 1), ("E_loc", -1)):
        above, below = column(tables[name], "weak")["strong"], column(tables[name], "strong")["weak"]
        assert above.key == pytest.approx(-below.key)
        assert above.key * better > 0
        assert (above.mark, below.mark) == ("better", "worse")
        assert re.search(r"p [<=] 0\.0\d+, n = 24", above.detail)
        assert column(tables[name], "holder")["strong"].text == "–"
        assert column(tables[name], "strong")["strong"].text == "–"
    apart = column(tables["commands"], "weak")["strong"]
    assert apart.key > 0
    assert "p " not in apart.detail
    assert comparison_tables(entries[:1]) == []


def test_kind_tables_count_their_episodes(entries: list[Entry], content: dict):
    for entry, table in zip(entries, content["per_kind"], strict=True):
        assert sum(int(cell.text) for cell in column(table, "n").values()) == 24
        assert table.caption == entry.label


def test_the_glossary_defines_every_metric():
    assert [row[0].text for row in glossary().rows] == METRICS.names()
    assert all(len(row[-1].text) > 60 for row in glossary().rows)
