"""The interface of a figure: a drawing of the evaluations, or None where they hold nothing to draw."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynahoi_lerobot.foundation.registry import Registry
from dynahoi_lerobot.report.entries import Entry
from dynahoi_lerobot.report.style import figure_style, svg_data_uri

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[[Sequence[Entry]], "Figure | None"]


@dataclass(frozen=True)
class ReportFigure:
    """One figure of the report.

    Attributes:
        name: the anchor on the page.
        title: the heading on the page.
        place: figures appear in the order of this number.
        draw: returns the drawing, or None where the entries hold nothing to draw; its docstring is the caption.
    """

    name: str
    title: str
    place: int
    draw: Draw

    @property
    def caption(self) -> str:
        """What the figure shows and which figure of the paper it answers."""
        return " ".join(inspect.cleandoc(self.draw.__doc__ or "").replace("``", "").split())

    def render(self, entries: Sequence[Entry]) -> str | None:
        """Return the drawing as a ``data:`` address, or None."""
        with figure_style():
            drawing = self.draw(entries)
            return None if drawing is None else svg_data_uri(drawing)


FIGURES: Registry[ReportFigure] = Registry("figure", "dynahoi_lerobot.report.figures")


def figure(name: str, title: str, place: int) -> Callable[[Draw], ReportFigure]:
    """Return a decorator that turns a drawing function into the registered figure ``name``."""

    def decorate(draw: Draw) -> ReportFigure:
        return FIGURES.register(name)(ReportFigure(name, title, place, draw))

    return decorate


def in_order() -> list[ReportFigure]:
    """Return every registered figure in the order of the page."""
    return sorted((entry for _, entry in FIGURES.items()), key=lambda entry: (entry.place, entry.name))
