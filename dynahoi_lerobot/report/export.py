"""The tables of a report for a paper: CSV with one number a line, and LaTeX.

Both begin with a comment that names the episodes, seeds, versions and statistics.
"""

import csv
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot import __version__
from dynahoi_lerobot.core.escaping import latex, printable
from dynahoi_lerobot.core.files import write_atomically, write_text_atomically
from dynahoi_lerobot.evaluate import table
from dynahoi_lerobot.evaluate.compare import SIGNIFICANT
from dynahoi_lerobot.evaluate.results import CONDITIONS, WEIGHTS
from dynahoi_lerobot.evaluate.rows import measured
from dynahoi_lerobot.evaluate.summary import RESAMPLES, SEED, Estimate
from dynahoi_lerobot.evaluate.table import Cell, Table
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report.comparisons import pairs, pairs_table
from dynahoi_lerobot.report.entries import Entry

STATISTICS = (
    f"95 % intervals: Wilson's for rates, bootstrap for means and paired differences ({RESAMPLES} "
    f"resamples, seed {SEED}). p: exact McNemar test for rates, paired permutation test for means, "
    f"not corrected for the number of comparisons."
)
PLAYED = ("split", *table.RESTRICTIONS, *CONDITIONS, "benchmark")
"""Columns that describe the episodes played."""
NUMBERS = ("value", "low", "high", "n", "p_value")
COLUMNS: tuple[str, ...] = (
    "table",
    "policy",
    "against",
    "category",
    "metric",
    "unit",
    *NUMBERS,
    *PLAYED,
)
PREAMBLE = (
    r"The preamble needs \usepackage{booktabs}. Bold: better than every other row under the same "
    rf"conditions, paired by episode, p < {SIGNIFICANT}."
)


def write_csv(entries: Sequence[Entry], path: Path, across: Collection[str] = ()) -> None:
    """Write one line for each number, which ``pandas.read_csv(path, comment="#")`` reads.

    ``table`` is ``main``, ``category`` or ``pair``, whose value is ``policy`` minus ``against``.
    Conditions are ``policy``'s. Fractions are from 0 to 1. A metric that does not apply has
    an empty value and n = 0.
    """

    def write(draft: Path) -> None:
        with draft.open("w", encoding="utf-8", newline="") as file:
            file.writelines(f"# {line}\n" for line in provenance(entries))
            # text in quotes, so that a policy called #1 begins no comment
            writer = csv.DictWriter(
                file, COLUMNS, restval="", quoting=csv.QUOTE_STRINGS, lineterminator="\n"
            )
            writer.writeheader()
            writer.writerows(_lines(entries, across))

    write_atomically({path: write})


def write_latex(entries: Sequence[Entry], path: Path, across: Collection[str] = ()) -> None:
    """Write the main table, S_loc by category and the pairs as tables of the package booktabs."""
    labels = [entry.label for entry in entries]
    results = [entry.results for entry in entries]
    main = table.metrics_table(labels, results, table.columns_for(results))
    main = replace(main, caption=f"Main metrics with 95 % intervals: {main.caption}.")
    tables = [main, *category_tables(entries), pairs_table(entries, across)]
    comment = [*provenance(entries), PREAMBLE]
    parts = ["\n".join(f"% {line}" for line in comment)]
    parts += [_latex_table(data) for data in tables if data.rows]
    write_text_atomically(path, "\n\n".join(parts) + "\n")


def category_tables(entries: Sequence[Entry]) -> list[Table]:
    """Return S_hold by category of the evaluations under contact, if any, and S_loc of all."""
    held = [entry for entry in entries if entry.results.summary["S_hold"].n]
    shown = {"S_hold": held, "S_loc": entries}
    return [
        table.category_table(
            [entry.label for entry in chosen],
            [entry.results for entry in chosen],
            name,
            f"{table.heading(name)} by category of motion.",
        )
        for name, chosen in shown.items()
        if chosen
    ]


def provenance(entries: Sequence[Entry]) -> list[str]:
    """Return the lines of the comment: the statistics, and of each evaluation policy, seeds and
    versions.
    """
    lines = [f"dynahoi report of dynahoi_lerobot {__version__}", STATISTICS]
    for entry in entries:
        info = entry.results.info
        rows = entry.results.rows
        told = {
            "policy": info.policy,
            "split": info.split,
            "seeds": ranges([row["seed"] for row in rows]),
            "episodes": len(rows),
            "benchmark": info.benchmark,
            "code": info.code,
            **info.extra.get("surroundings", {}),
            **(info.extra.get(WEIGHTS) or {}),
        }
        facts = ", ".join(f"{name} {value}" for name, value in told.items())
        lines.append(printable(f"{entry.label}: {facts}"))
    return lines


def ranges(numbers: Sequence[int]) -> str:
    """Return ascending numbers in words, such as ``0-109, 200``."""
    ordered = np.unique(numbers)
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)


# -- CSV -------------------------------------------------------------------------------------------


def _lines(entries: Sequence[Entry], across: Collection[str]) -> Iterator[dict[str, Any]]:
    """Yield the values of each line by column."""
    for entry in entries:
        yield from _estimates(entry, "main", entry.results.summary)
    for entry in entries:
        for category, summary in entry.results.by("category").items():
            yield from _estimates(entry, "category", summary, category=category)
    for a, b, name, found in pairs(entries, across):
        yield _line(a, "pair", name, found, against=b.label)


def _estimates(
    entry: Entry, name: str, summary: dict[str, Estimate], **texts: str
) -> Iterator[dict[str, Any]]:
    for metric in measured(entry.results.rows):
        yield _line(entry, name, metric, summary[metric], **texts)


def _line(entry: Entry, name: str, metric: str, found: Estimate, **texts: str) -> dict[str, Any]:
    line = {"table": name, "policy": entry.label, "metric": metric, "unit": found.unit, **texts}
    line |= {column: getattr(found, column, None) for column in NUMBERS}
    return line | table.conditions(entry.results)


# -- LaTeX -----------------------------------------------------------------------------------------


def _latex_table(data: Table) -> str:
    """Return a table with the smaller line of each cell in a row of its own."""
    lines = [
        r"\begin{table*}",
        r"\centering\footnotesize\setlength{\tabcolsep}{4pt}",
        rf"\caption{{{typeset(data.caption)}}}",
        rf"\begin{{tabular}}{{{''.join('r' if number else 'l' for number in data.numeric())}}}",
        r"\toprule",
        *_head(data.head),
        r"\midrule",
        *chain.from_iterable(map(_rows, data.rows)),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table*}",
    ]
    return "\n".join(lines)


def _head(titles: Sequence[str]) -> Iterator[str]:
    """Yield a row of titles, and a second row for the text after their commas if any."""
    parts = [title.partition(", ") for title in titles]
    yield _row(typeset(title) for title, _, _ in parts)
    if any(rest for _, _, rest in parts):
        yield _row(typeset(rest) for _, _, rest in parts)


def _rows(cells: Sequence[Cell]) -> Iterator[str]:
    """Yield a row of the cells' texts, and one of their smaller lines if there is any."""
    yield _row(map(_value, cells))
    if any(cell.detail for cell in cells):
        yield _row(_small(cell.detail) for cell in cells)


def _row(texts: Iterable[str]) -> str:
    """Return a row of cells; the end of a row would take a bracket or star after it for its own."""
    row = " & ".join(texts) + r" \\"
    return "{}" + row if row.startswith(("[", "*")) else row


def _small(text: str) -> str:
    return rf"{{\scriptsize {numbers(text)}}}" if text else ""


def _value(cell: Cell) -> str:
    text = typeset(cell.text) if cell.key is None else numbers(cell.text)
    return rf"\textbf{{{text}}}" if cell.mark == "best" else text


def typeset(text: str) -> str:
    """Return text for LaTeX, with metrics such as S_loc in mathematical type."""
    return " ".join(_symbol(word) or latex(word) for word in text.split(" "))


def numbers(text: str) -> str:
    """Return text of numbers for LaTeX, with minus signs for hyphens."""
    return re.sub(r"-(?=\d)", "$-$", latex(text))


def _symbol(word: str) -> str:
    """Return a metric's name as a letter with an index; empty for other words."""
    letter, _, index = word.partition("_")
    if word not in METRICS or len(letter) != 1:
        return ""
    return rf"${letter}_\mathrm{{{index.replace('_', r'\ ')}}}$"
