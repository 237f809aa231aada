"""The evaluations of one report, each with a short unique label and a mark of its own."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.escaping import printable, shortened
from dynahoi_lerobot.core.reading import LeftOut, ReadError
from dynahoi_lerobot.evaluate.compare import refuse_mixture
from dynahoi_lerobot.evaluate.results import Results, finished, read_results
from dynahoi_lerobot.evaluate.rows import Row, identity

COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8c6bb1", "#999999")
"""Okabe and Ito's color-blind safe palette without black and yellow, legible on light and dark."""
SHAPES: tuple[tuple[str, str, Any, str], ...] = (
    ("o", "●", "solid", ""),
    ("s", "■", (0, (5, 1.5)), "///"),
    ("^", "▲", (0, (1, 1)), "..."),
    ("D", "◆", (0, (6, 1.5, 1, 1.5)), "xxx"),
    ("v", "▼", (0, (3, 1, 1, 1, 1, 1)), "---"),
    ("P", "✚", (0, (9, 3)), "|||"),
)
"""Matplotlib's marker, the same as a letter, dashes of lines and hatching of bars: the first for
the first eight evaluations, and so on."""

LABEL_LENGTH = 40

GENERIC_FOLDERS = {"checkpoints", "last", "pretrained_model", "training"}
"""Folder names of training runs that do not identify the policy."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One evaluation of a report, and what tells it from the others in figures.

    Attributes:
        results: the evaluation.
        label: unique within the report.
        color: hexadecimal RGB.
        marker, letter, dashes, hatch: see ``SHAPES``.
    """

    results: Results
    label: str
    color: str
    marker: str
    letter: str
    dashes: Any
    hatch: str

    @classmethod
    def of(cls, results: Results, label: str, place: int) -> "Entry":
        """Return the evaluation in this place; each of the first 48 looks different."""
        shape = SHAPES[place // len(COLORS) % len(SHAPES)]
        return cls(results, label, COLORS[place % len(COLORS)], *shape)


def read_entries(folders: Sequence[Path], *, allow_version_mismatch: bool = False) -> list[Entry]:
    """Read result folders, each once, best S_loc first; one that cannot be read or is unfinished
    is left out, with a warning.

    Raises:
        ReadError: if all are left out.
        ValueError: if they are of different salts, or, unless ``allow_version_mismatch``, of
            different versions of the benchmark.
    """
    results = _readable(folders)
    refuse_mixture(results, allow_version_mismatch=allow_version_mismatch)
    results.sort(key=lambda result: -(result.summary["S_loc"].value or 0.0))
    labels = unique_labels(results)
    return [
        Entry.of(result, label, place)
        for place, (result, label) in enumerate(zip(results, labels, strict=True))
    ]


def _readable(folders: Sequence[Path]) -> list[Results]:
    """Return the finished results that can be read; name the others in warnings."""
    results: list[Results] = []
    problems: list[ReadError] = []
    named: dict[Path, Path] = {}  # by where they lead, as they were called first
    for folder in folders:
        named.setdefault(folder.resolve(), folder.absolute())
    for folder in named.values():
        try:
            results.append(finished(read_results(folder)))
        except ReadError as error:
            problems.append(error)
    if not results:
        raise problems[0]
    for problem in problems:
        warnings.warn(f"left out: {problem}", LeftOut, stacklevel=3)
    return results


def unique_labels(results: Sequence[Results]) -> list[str]:
    """Return a unique label per result: policy and unusual rules, then folder and number if
    needed.
    """
    labels = [clip(_label(result)) for result in results]
    labels = [
        clip(f"{label} ({result.folder.name})") if labels.count(label) > 1 else label
        for label, result in zip(labels, results, strict=True)
    ]
    return [
        f"{label} #{labels[:place].count(label) + 1}" if labels.count(label) > 1 else label
        for place, label in enumerate(labels)
    ]


def _label(result: Results) -> str:
    rules = [result.info.extra.get("inference")]
    for title, name, usual in (("noise", "render_noise", "0"), ("speed", "path_speed", "1")):
        if result.conditions[name] != usual:
            rules.append(f"{title} {result.conditions[name]}")
    return ", ".join(filter(None, (result.marked(short_name(result.info.policy)), *rules)))


def short_name(policy: str) -> str:
    """Return the distinctive part of a policy's name: for a path to a checkpoint, the name of the
    training run.
    """
    parts = [part for part in re.split(r"[\\/]", policy) if part.strip()]
    distinctive = [part for part in parts if part not in GENERIC_FOLDERS and not part.isdigit()]
    return clip((distinctive or parts or ["?"])[-1])


def clip(text: str) -> str:
    """Return ``text`` in printable characters, shortened in the middle."""
    return shortened(printable(text.strip()), LABEL_LENGTH)


def distinct_episodes(entries: Sequence[Entry]) -> list[Row]:
    """Return one row per distinct episode of all evaluations."""
    return list({identity(row): row for entry in entries for row in entry.results.rows}.values())
