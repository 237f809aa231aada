"""A report's tables for a paper: the same numbers as on the page, in files that other programs
read.
"""

import re
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dynahoi_lerobot import __version__
from dynahoi_lerobot.evaluate.compare import compare
from dynahoi_lerobot.evaluate.summary import Estimate
from dynahoi_lerobot.evaluate.table import columns_for, metrics_table
from dynahoi_lerobot.report import figures
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.report.export import ranges, write_csv, write_latex
from tests.report.example_runs import example_run
from tests.tools import dynahoi

ODD = "#1 a & 50% $x_y^{2}$ ~ [0] é"


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    root = tmp_path_factory.mktemp("runs")
    example_run(root / "odd", ODD, 0.9, 44)
    example_run(root / "weak", "*weak", 0.2, 40)
    example_run(root / "contact", "[contact]", 0.5, 44, capture="contact")
    return read_entries(sorted(root.iterdir()))


@pytest.fixture(scope="module")
def lines(entries: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    path = tmp_path_factory.mktemp("csv") / "table.csv"
    write_csv(entries, path)
    return pd.read_csv(path, comment="#").fillna({"category": "", "against": ""})


def check_lines(lines: pd.DataFrame, wanted: dict[Any, Estimate]) -> None:
    """Lines of the file, by their index, must be ``wanted`` and nothing else."""
    frame = pd.DataFrame.from_dict({key: vars(found) for key, found in wanted.items()}, "index")
    found = lines[frame.columns].sort_index()
    frame = frame.astype(found.dtypes).sort_index()
    pd.testing.assert_frame_equal(found, frame, check_names=False, rtol=0.0, atol=1e-12)


def test_csv_has_every_estimate_of_all_episodes_and_by_category(
    entries: list[Entry], lines: pd.DataFrame
):
    lines = lines[lines.table != "pair"]
    for entry in entries:
        own = lines[lines.policy == entry.label]
        assert set(own.capture) == {entry.results.info.capture}
        groups = {"": entry.results.summary} | entry.results.by("category")
        for category, summary in groups.items():
            check_lines(own[own.category == category].set_index("metric"), summary)


def test_csv_has_every_pair_once_with_interval_number_and_p(
    entries: list[Entry], lines: pd.DataFrame
):
    wanted = {
        (a.label, b.label, name): compare(a.results, b.results, name)
        for a, b in combinations(entries, 2)
        for name in ("S_loc", "S_joint", "E_loc", "commands")
        if a.results.info.capture == b.results.info.capture
    }
    assert [found.n for found in wanted.values()] == [40] * 4
    check_lines(lines[lines.table == "pair"].set_index(["policy", "against", "metric"]), wanted)


def test_a_comment_says_which_seeds_and_versions(entries: list[Entry], tmp_path: Path):
    write_csv(entries, tmp_path / "t.csv")
    write_latex(entries, tmp_path / "t.tex")
    for name, mark in (("t.csv", "# "), ("t.tex", "% ")):
        text = (tmp_path / name).read_text()
        comment = [line for line in text.splitlines() if line.startswith(mark)]
        assert any(__version__ in line for line in comment)
        for entry in entries:
            (line,) = [line for line in comment if line.startswith(f"{mark}{entry.label}: ")]
            info = entry.results.info
            told = f"seeds 0-{len(entry.results.rows) - 1}", info.benchmark, info.code
            assert all(word in line for word in told)
    assert ranges([5, 0, 1, 2, 9, 8]) == "0-2, 5, 8-9"


# -- LaTeX -----------------------------------------------------------------------------------------

CONTROL = r"\\(?:[a-zA-Z]+\*?|.)"
BARE = r"(?<!\\)[#%~^]"


def tables_of(text: str) -> list[str]:
    """The tables of a LaTeX file, without its comments."""
    code = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    return re.findall(r"\\begin{table\*}.*?\\end{table\*}", code, re.DOTALL)


def rows_of(table: str) -> list[list[str]]:
    body = table.partition(r"\toprule")[2].partition(r"\bottomrule")[0]
    rows = [row.strip() for row in body.replace(r"\midrule", "").split(r"\\" + "\n")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)&", row)] for row in rows if row]


def test_latex_is_balanced_and_escaped(entries: list[Entry], tmp_path: Path):
    write_latex(entries, tmp_path / "t.tex")
    tables = tables_of((tmp_path / "t.tex").read_text())
    assert len(tables) == 4, "main, two by category, pairs"
    for table in tables:
        columns = re.search(r"\\begin{tabular}{([lr]+)}", table)
        assert columns
        for row in rows_of(table):
            assert len(row) == len(columns[1])
            assert not row[0].startswith(("[", "*")), "it would be the option of the row's end"
        plain = re.sub(CONTROL, "", table)
        assert plain.count("{") == plain.count("}")
        assert plain.count("$") % 2 == 0
        assert not re.search(BARE, plain)
        known = {"begin", "end", "centering", "footnotesize", "setlength", "tabcolsep", "caption"}
        known |= {"toprule", "midrule", "bottomrule", "scriptsize", "mathrm", "uparrow", "ldots"}
        known |= {"downarrow", "textbf", "textbackslash", "textasciitilde", "textasciicircum"}
        assert set(re.findall(r"\\([a-zA-Z]+)", table)) <= known


def test_latex_has_the_numbers_of_the_page(entries: list[Entry], tmp_path: Path):
    write_latex(entries, tmp_path / "t.tex")
    rows = rows_of(tables_of((tmp_path / "t.tex").read_text())[0])
    results = [entry.results for entry in entries]
    page = metrics_table([entry.label for entry in entries], results, columns_for(results))
    numbers = [row for row in rows[1:] if row[0]]
    details = [row for row in rows[1:] if not row[0]]
    for shown, values, smaller in zip(page.rows, numbers, details, strict=True):
        for cell, value, small in zip(shown[1:], values[1:], smaller[1:], strict=True):
            assert cell.text == value.removeprefix(r"\textbf{").removesuffix("}")
            assert cell.detail == small.removeprefix(r"{\scriptsize ").removesuffix("}")
            assert value.startswith(r"\textbf") == (cell.mark == "best")


def test_the_command_writes_both_and_refuses_folders_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(figures, "FIGURES", {})
    example_run(tmp_path / "a", "a", 0.9, 6)
    words = ["report", tmp_path / "a", "--out", tmp_path / "report.html"]
    dynahoi(*words, "--csv", tmp_path / "t.csv", "--latex", tmp_path / "t.tex")
    read = pd.read_csv(tmp_path / "t.csv", comment="#")
    assert set(read.table) == {"main", "category"}, "one evaluation has no pairs"
    assert r"\begin{tabular}" in (tmp_path / "t.tex").read_text()
    for name in ("--csv", "--latex"):
        said = dynahoi(*words, name, tmp_path / "a", code=2).err
        assert f"{name} must name a file" in said
