"""The report's tables hold the numbers that were measured, and mark the right ones."""

from __future__ import annotations

import pytest

from dynahoi_lerobot.evaluate.table import printed_parts
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report.entries import Entry, read_entries
from dynahoi_lerobot.report.tables import comparison_tables, glossary, main_metrics, other_metrics, stratum_tables
from tests.report.example_runs import example_run


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    root = tmp_path_factory.mktemp("runs")
    example_run(root / "strong", "strong", 1.0, 24)
    example_run(root / "weak", "weak", 0.1, 24)
    example_run(root / "holder", "holder", 0.5, 24, capture="contact")
    return read_entries([root / "strong", root / "weak", root / "holder"])


def column(table, title: str) -> dict[str, object]:
    place = next(index for index, head in enumerate(table.head) if head.split()[0] == title)
    return {row[0].text: row[place] for row in table.rows}


def test_the_results_hold_every_estimate(entries: list[Entry]):
    table = main_metrics(entries)
    assert len(table.rows) == 3
    for entry in entries:
        for name in ("S_loc", "E_loc", "S_gra", "Q_line", "R_time", "S_joint", "S_hold"):
            cell = column(table, name)[entry.label]
            assert (cell.text, cell.detail) == printed_parts(entry.summary[name])
            assert cell.key == entry.summary[name].value
    assert " n 24" in table.caption


def test_conditions_are_columns_where_evaluations_differ_and_in_the_caption_where_they_agree(entries: list[Entry]):
    table = main_metrics(entries)
    assert sorted(cell.text for cell in column(table, "capture").values()) == ["attach", "attach", "contact"]
    assert "split" not in table.head
    assert f"split {entries[0].results.info.split}" in table.caption


def test_the_best_is_marked_within_its_split_and_rule_only(entries: list[Entry]):
    table = main_metrics(entries)
    for name in ("S_loc", "E_loc", "R_time"):
        marks = {label: cell.mark for label, cell in column(table, name).items()}
        assert marks == {"strong": "best", "weak": "", "holder": ""}
    assert not any(cell.mark for cell in column(table, "S_hold").values())
    across_rules = [entry for entry in entries if entry.label != "strong"]
    assert not any(cell.mark for row in main_metrics(across_rules).rows for cell in row)


def test_both_tables_together_hold_every_metric(entries: list[Entry]):
    titles = [head.split()[0] for head in (*main_metrics(entries).head, *other_metrics(entries).head)]
    assert all(titles.count(name) == 1 for name in METRICS.names())


def test_the_comparison_is_antisymmetric_and_within_one_rule(entries: list[Entry]):
    tables = {table.caption.split()[0]: table for table in comparison_tables(entries)}
    assert set(tables) == {"S_loc", "S_joint", "E_loc"}, "S_hold has no pair: one run only was played by contact"
    for name, better in (("S_loc", 1), ("E_loc", -1)):
        above, below = column(tables[name], "weak")["strong"], column(tables[name], "strong")["weak"]
        assert above.key == pytest.approx(-below.key)
        assert above.key * better > 0
        assert (above.mark, below.mark) == ("better", "worse")
        assert "p < 0.001" in above.detail or "p = 0.0" in above.detail
        assert "n = 24" in above.detail
        assert column(tables[name], "holder")["strong"].text == "–"
        assert column(tables[name], "strong")["strong"].text == "–"


def test_one_evaluation_alone_has_nothing_to_compare_with(entries: list[Entry]):
    assert comparison_tables(entries[:1]) == []


def test_kind_tables_count_their_episodes(entries: list[Entry]):
    for entry, table in zip(entries, stratum_tables(entries, "kind"), strict=True):
        assert sum(int(cell.text) for cell in column(table, "n").values()) == 24
        assert table.caption == entry.label
        assert column(table, "S_loc")["lob"].text == printed_parts(entry.by("kind")["lob"]["S_loc"])[0]


def test_the_glossary_defines_every_metric():
    table = glossary()
    assert [row[0].text for row in table.rows] == METRICS.names()
    assert all(len(row[-1].text) > 60 for row in table.rows)
