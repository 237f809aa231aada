"""Style of the figures: thin lines, no frame, and a text colour that follows the page's light or dark scheme."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#0a0b0c"
"""Placeholder for the text colour while drawing; in the SVG the page's text colour replaces it."""

WIDTH = 12.0
"""Width of every figure [inch], which is the width of the page's column."""

_INK_CSS = "<style>:root{--ink:#1f2328}@media(prefers-color-scheme:dark){:root{--ink:#e6e8eb}}</style>"

_RC: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "dynahoi",
    "text.parse_math": False,  # a policy may be called $x
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial"],
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.alpha": 0.15,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
    "grid.color": INK,
}


class Labelled(Protocol):
    """What a legend names."""

    @property
    def label(self) -> str:
        """Its name."""
        ...

    @property
    def colour(self) -> str:
        """Hexadecimal RGB."""
        ...


@contextmanager
def figure_style() -> Iterator[None]:
    """Draw in the report's style, whatever the user's own matplotlib settings are."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def new_figure(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure of the page's width and ``height`` [inch], and its axes row by row."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(WIDTH, height), layout=ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.06))
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, list(grid.ravel())


def legend(figure: Figure, shown: Sequence[Labelled]) -> None:
    """Put the colours of what is shown above the axes."""
    from matplotlib.patches import Patch

    handles = [Patch(color=entry.colour, label=entry.label) for entry in shown]
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(shown), 4))


def hide_unused(axes: Sequence[Axes], used: int) -> None:
    """Remove the axes beyond the first ``used``."""
    for unused in axes[used:]:
        unused.remove()


def svg_data_uri(figure: Figure) -> str:
    """Return the figure as a ``data:`` address of an SVG that follows the page's light or dark scheme.

    As an image it is inert: nothing written in it can run or load anything.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))  # nothing that changes between runs
    FigureCanvasSVG(figure).print_svg(buffer, metadata=metadata)
    drawing = buffer.getvalue().replace(INK, "var(--ink)")
    start = drawing.index("<svg")
    body = drawing.index(">", start) + 1
    svg = drawing[start:body] + _INK_CSS + drawing[body:]
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()
