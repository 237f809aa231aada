"""The report: figures of any results, labels that tell them apart, a page that loads nothing,
honest comparisons.
"""

import base64
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from dynahoi_lerobot.evaluate.gif import write_gif
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.evaluate.table import Table, columns_for, metric_cell
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report import figures, page, render_report
from dynahoi_lerobot.report.entries import (
    Entry,
    distinct_episodes,
    read_entries,
    short_name,
    unique_labels,
)
from dynahoi_lerobot.report.page import clips_of, comparison_tables, page_content
from tests.report.example_runs import example_run, play
from tests.synthetic import run_info, write_results
from tests.tools import dynahoi, edit_json

HOSTILE = (
    "<script>alert('x')</script><img src=https://evil.example/a.png onerror=alert(1)>\"&{{ "
    "7*7 }} $x^{"
)
FIGURES = dict(figures.FIGURES)
ALWAYS = {
    "main",
    "stages",
    "time-to-catch",
    "per-frame-grasp",
    "data",
    "joint-deltas",
    "palm-displacements",
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result folders: of three honest policies, of a hostile one, and of two that differ by their
    inference.
    """
    root = tmp_path_factory.mktemp("runs")
    example_run(root / "strong", "strong", 1.0, 24)
    example_run(root / "weak", "weak", 0.1, 24)
    example_run(root / "holder", "holder", 0.5, 24, capture="contact")
    odd = {"note": "<b>", "number": 10**15}
    example_run(
        root / "hostile", HOSTILE, 0.9, 24, command=f"dynahoi evaluate --policy '{HOSTILE}'", **odd
    )
    for label in ("rtc 150 ms", "async measured"):
        example_run(root / label, "contact", 0.4, 12, capture="contact", inference=label)
    for index in range(2):
        write_gif(
            root / "strong" / f"clip_{index}.gif", np.full((3, 8, 8, 3), 90 * index, np.uint8)
        )
    return root


@pytest.fixture(scope="module")
def entries(runs: Path) -> list[Entry]:
    return read_entries(
        [runs / "strong", runs / "weak", runs / "holder", runs / "weak" / ".." / "weak"]
    )


@pytest.fixture(scope="module")
def odd(runs: Path) -> list[Entry]:
    return read_entries([runs / "hostile", runs / "rtc 150 ms", runs / "async measured"])


# -- labels ----------------------------------------------------------------------------------------


def named(policy: str, folder: str = "run", **extra: object) -> Results:
    recipe = extra.pop("recipe", {})
    return Results(Path(folder), run_info(policy, extra=extra, **recipe), (), ())


@pytest.mark.parametrize(
    ("policy", "label"),
    [
        ("outputs/train/obact/checkpoints/last/pretrained_model", "obact"),
        ("someone/obact_dynahoi", "obact_dynahoi"),
        ("a" + "x" * 99 + "z", f"a{'x' * 18}…{'x' * 18}z"),
    ],
)
def test_a_label_is_the_telling_part_of_a_name(policy: str, label: str):
    assert short_name(policy) == label


def test_equal_names_are_told_apart_by_conditions_then_folder_then_number():
    late = named("obact", inference="async 150 ms")
    noisy = named("obact", recipe={"render_noise": 2})
    assert unique_labels([late, noisy, named("obact")]) == [
        "obact, async 150 ms",
        "obact, noise 2",
        "obact",
    ]
    assert unique_labels([named("a", "s1"), named("a", "s5"), named("b")]) == [
        "a (s1)",
        "a (s5)",
        "b",
    ]
    assert unique_labels([named("a", "x/run"), named("a", "y/run")]) == ["a (run) #1", "a (run) #2"]


def test_entries_come_best_first_and_once(entries: list[Entry]):
    assert [entry.label for entry in entries] == ["strong", "holder", "weak"]
    assert len({(entry.color, entry.marker) for entry in entries}) == 3
    assert len(distinct_episodes(entries)) == 24


def unfinished(root: Path) -> list[Path]:
    """Things that `results/*` may name and nobody can read."""
    example_run(root / "damaged", "p", 0.5, 4)
    (root / "damaged" / "actions.npz").write_bytes(b"half")
    example_run(root / "older", "p", 0.5, 4)
    edit_json(root / "older" / "metrics.json", schema=0)
    example_run(root / "begun", "p", 0.5, 4)
    (root / "begun" / "metrics.json").unlink()
    example_run(root / "stopped", "p", 0.5, 4, episodes_asked=6)
    (root / "empty").mkdir()
    (root / "notes.txt").write_text("mine")
    return sorted(root.iterdir())


def test_a_linked_folder_counts_once_under_the_name_that_it_was_called_by(
    tmp_path: Path, runs: Path
):
    link = tmp_path / "mine"
    link.symlink_to(runs / "strong", target_is_directory=True)
    (entry,) = read_entries([link, runs / "strong"])
    assert entry.results.folder == link


def test_folders_that_cannot_be_read_are_left_out_with_a_word_each(
    tmp_path: Path, runs: Path, monkeypatch
):
    monkeypatch.setattr(figures, "FIGURES", {})
    bad = unfinished(tmp_path)
    words = ["report", "--out", tmp_path / "report.html", *bad]
    out, err = dynahoi(*words, runs / "strong", runs / "weak")
    for path in bad:
        assert sum(f"/{path.name}" in line for line in err.splitlines()) == 1
    assert len(err.splitlines()) == len(bad)
    assert "strong" in out
    assert len(dynahoi(*words, code=2).err.splitlines()) == 1, "nothing is left"


# -- figures ---------------------------------------------------------------------------------------


def render(name: str, entries: list[Entry]) -> str | None:
    return figures.render(FIGURES[name][1], entries)


@pytest.mark.parametrize("name", figures.FIGURES)
def test_a_figure_is_a_well_formed_inert_drawing(name: str, odd: list[Entry]):
    address = render(name, odd)
    text = base64.b64decode(address.removeprefix("data:image/svg+xml;base64,")).decode()
    root = ElementTree.fromstring(text)
    assert not {"script", "foreignObject"} & {
        element.tag.partition("}")[2] for element in root.iter()
    }
    links = [
        value
        for element in root.iter()
        for key, value in element.attrib.items()
        if key.endswith("href")
    ]
    assert all(link.startswith(("#", "data:")) for link in links)
    assert "nan" not in "".join(element.get("d", "") for element in root.iter())
    assert "var(--ink)" in text
    if name == "stages":
        assert any((element.text or "").strip() == odd[0].label for element in root.iter())
        assert address == render(name, odd), "the same results give the same drawing"


def test_figures_of_one_episode_are_drawn_or_left_out(tmp_path: Path):
    example_run(tmp_path, "lone", 0.0, 1)
    lone = read_entries([tmp_path])
    drawn = {name for name in figures.FIGURES if render(name, lone) is not None}
    assert drawn == ALWAYS


def words_of(address: str) -> list[str]:
    text = base64.b64decode(address.removeprefix("data:image/svg+xml;base64,")).decode()
    root = ElementTree.fromstring(text)
    return [(element.text or "").strip() for element in root.iter() if element.text]


def test_a_figure_of_grasps_leaves_out_whom_they_do_not_apply_to(odd: list[Entry]):
    contact = [entry for entry in odd if entry.results.info.capture == "contact"]
    assert render("per-frame-grasp", contact) is None
    words = words_of(render("per-frame-grasp", odd))
    assert contact[0].label not in words
    assert all("S_joint" not in word for word in words_of(render("main", contact)))


# -- tables ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def content(entries: list[Entry]) -> dict:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "FIGURES", {})
        return page_content(entries)


def column(table: Table, title: str) -> dict:
    place = next(index for index, head in enumerate(table.head) if head.split()[0] == title)
    return {row[0].text: row[place] for row in table.rows}


def test_both_tables_together_hold_every_estimate_once(entries: list[Entry], content: dict):
    tables = content["main_metrics"], content["other_metrics"]
    for name in METRICS.names():
        (table,) = [
            table for table in tables if any(head.split()[0] == name for head in table.head)
        ]
        for entry in entries:
            assert (
                column(table, name)[entry.label].text
                == metric_cell(entry.results.summary[name]).text
            )


def test_conditions_are_columns_where_evaluations_differ_and_in_the_caption_where_they_agree(
    content: dict,
):
    table = content["main_metrics"]
    assert sorted(cell.text for cell in column(table, "capture").values()) == [
        "attach",
        "attach",
        "contact",
    ]
    assert "split" not in table.head
    assert "split test_small" in table.caption
    assert "n 24" in table.caption


def test_categories_have_interval_and_number(entries: list[Entry], content: dict):
    held, localised = content["categories"]
    assert [row[0].text for row in held.rows] == ["holder"]
    assert [row[0].text for row in localised.rows] == [entry.label for entry in entries]
    for entry, row in zip(entries, localised.rows, strict=True):
        for title, cell in zip(localised.head[1:], row[1:], strict=True):
            name, _, n = title.partition(", n = ")
            found = entry.results.by("category")[name.replace(" ", "_")]["S_loc"]
            assert int(n) == found.n
            assert (cell.text, cell.detail) == (metric_cell(found).text, metric_cell(found).detail)


def test_the_best_is_marked_under_equal_conditions_only(content: dict):
    marks = {label: cell.mark for label, cell in column(content["main_metrics"], "S_loc").items()}
    assert marks == {"strong": "best", "weak": "", "holder": ""}


def test_the_comparison_is_antisymmetric_and_under_equal_conditions(entries: list[Entry]):
    tables = dict(
        zip(("S_loc", "S_joint", "E_loc", "commands"), comparison_tables(entries), strict=True)
    )
    for name, better in (("S_loc", 1), ("E_loc", -1)):
        above = column(tables[name], "weak")["strong"]
        below = column(tables[name], "strong")["weak"]
        assert above.key == pytest.approx(-below.key)
        assert above.key * better > 0
        assert (above.mark, below.mark) == ("better", "worse")
        assert "n = 24" in above.detail
        assert column(tables[name], "holder")["strong"].text == "–"
    assert comparison_tables(entries[:1]) == []


# -- the page --------------------------------------------------------------------------------------


class Page(HTMLParser):
    """A page's tags with their attributes, and its visible text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def test_a_page_holds_everything_and_loads_nothing(runs: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(figures, "FIGURES", {"stages": FIGURES["stages"]})
    folders = [runs / "strong", runs / "hostile"]
    html = render_report(folders, runs / "report.html").read_text()
    parsed = Page(html)
    sections = {attributes["id"] for tag, attributes in parsed.tags if tag == "section"}
    assert sections == {"results", "comparison", "stages", "clips", "kinds", "runs", "glossary"}
    assert {attributes["href"] for tag, attributes in parsed.tags if tag == "a"} == {
        f"#{name}" for name in sections
    }
    assert f"dynahoi evaluate --policy '{HOSTILE}'" in parsed.text
    before_figures = html.partition("<figure>")[0]
    for name in columns_for([read_results(folder) for folder in folders]):
        assert f"<dt>{name}</dt>" in before_figures, "what it means is said before it is drawn"
    clips = [
        a["alt"]
        for tag, a in parsed.tags
        if tag == "img" and a["src"].startswith("data:image/gif;base64,")
    ]
    assert clips == ["clip_0", "clip_1"]
    names = [tag for tag, _ in parsed.tags]
    assert names.count("script") == 1
    assert {"b", "link", "iframe", "object", "embed", "base"}.isdisjoint(names)
    for _, attributes in parsed.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            assert attributes.get(name, "#").startswith(("#", "data:image/"))
    assert "url(" not in html.partition("</style>")[0]
    policy = next(
        a["content"] for tag, a in parsed.tags if a.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy.startswith("default-src 'none'")
    assert render_report(folders, runs / "strong") == runs / "strong" / "report.html"
    assert (runs / "strong" / "report.html").read_text() == html, "the page is the same every time"


def test_a_page_shows_words_and_no_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(figures, "FIGURES", {})
    told = {
        "notes": {"views": ["side", "top"], "salt": "", "hand": {"name": "capsule"}, "noise": 0},
        "settings": ["n_action_steps=2"],
        "privileged": True,
        "weights": None,
        "inference": "",
        "vlm": {},
    }
    example_run(tmp_path / "run", "p", 0.5, 4, **told)
    html = render_report([tmp_path / "run"], tmp_path / "report.html").read_text()
    shown = Page(html.partition('<section id="runs">')[2].partition("</section>")[0]).text
    assert "views side, top, hand name capsule, noise 0" in shown
    assert not re.search(r"[{}\[\]']|None|True", shown)
    assert not {"weights", "inference", "vlm"} & set(shown.split()), "nothing of what is empty"
    assert "``" not in html


def test_clips_are_the_first_gifs_of_the_folder_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "run"
    secret = tmp_path / "secret.gif"
    for path in (folder / "b.gif", folder / "a.gif", secret):
        write_gif(path, np.zeros((2, 8, 8, 3), np.uint8))
    (folder / "link.gif").symlink_to(secret)
    (folder / "text.gif").write_text("no GIF")
    assert [name for name, _ in clips_of(folder)[0]] == ["a", "b"]
    monkeypatch.setattr(page, "MOST_CLIPS", 1)
    assert clips_of(folder)[1] == 1


def test_evaluations_under_other_conditions_are_paired_only_where_that_is_asked_for(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(figures, "FIGURES", {"main": FIGURES["main"]})
    example_run(tmp_path / "a", "a", 0.9, 8, recipe={"render_noise": 0})
    example_run(tmp_path / "b", "a", 0.3, 8, recipe={"render_noise": 2})
    example_run(tmp_path / "old", "old", 0.5, 4, benchmark="v0")
    out = tmp_path / "report.html"

    def report(*words: object) -> str:
        return dynahoi("report", tmp_path / "a", *words, "--out", out).out + out.read_text()

    told = report(tmp_path / "b")
    assert "--across render_noise" in told
    assert "Paired comparison" not in told
    told = report(tmp_path / "b", "--across", "render_noise")
    assert "a minus a, noise 2, 8 episodes" in told
    assert "Paired comparison" in told
    other = {"render_noise": 2, "capture": "contact"}
    example_run(tmp_path / "c", "a", 0.3, 8, recipe=other, capture="contact")
    told = report(tmp_path / "c", "--across", "render_noise")
    assert "capture and hand are not paired; with different capture none can be" in told
    other = {"render_noise": 2, "split": "val", "motions": ("lob",)}
    results = example_run(tmp_path / "d", "a", 0.3, 8, recipe=other)
    write_results(tmp_path / "d", play(8, 0.3, split="val"), results.info)
    told = report(tmp_path / "d")
    assert "split and motions are not paired; with different split none can be" in told
    assert "--across" not in told
    said = dynahoi("report", tmp_path / "a", tmp_path / "old", code=2).err
    assert "has benchmark 'v0'" in said
    assert "v0" in report(tmp_path / "old", "--allow-version-mismatch")
