"""Draw the rooms of the core as docs/architecture.svg: ``uv run python -m docs.scripts.rooms_diagram``.

Rooms and arrows come from the imports, the words from the headings of docs/architecture.md. An arrow leads from a room
to one that it imports, unless a longer way along other arrows leads there, too.
"""

from __future__ import annotations

import re
from html import escape
from itertools import pairwise
from pathlib import Path

from docs.scripts.layered_layout import Layout, transitive_reduction
from tests.rooms import ROOMS, room_imports

DOCS = Path(__file__).parents[1]
PAGE, DRAWING = DOCS / "architecture.md", DOCS / "architecture.svg"
HEADING = re.compile(r"^### `(\w+)`: (.+)$", re.MULTILINE)

BOX_WIDTH, BOX_HEIGHT = 208.0, 44.0
GAP, BEND_GAP, ROW_HEIGHT, MARGIN = 20.0, 16.0, 78.0, 10.0
STYLE = """
:root{--ink:#1f2328;--soft:#59636e;--box:#f6f8fa;--line:#8c959f}
@media(prefers-color-scheme:dark){:root{--ink:#e6e8eb;--soft:#9198a1;--box:#151b23;--line:#656c76}}
text{font-family:DejaVu Sans,Verdana,Arial,sans-serif;text-anchor:middle;fill:var(--ink)}
.name{font-size:14px;font-weight:bold}
.what{font-size:11px;fill:var(--soft)}
rect{fill:var(--box);stroke:var(--line)}
path{fill:none;stroke:var(--line);stroke-width:1.3}
.head{fill:var(--line);stroke:none}
"""


def captions(page: str) -> dict[str, str]:
    """Return what the page's heading of each room says, in the page's order."""
    return dict(HEADING.findall(page))


def draw(page: str) -> str:
    """Return the SVG of the rooms as the imports are now, with the captions of ``page``.

    Raises:
        KeyError: for a room without a heading ``### `room`: caption``.
    """
    layout = Layout.of(transitive_reduction(room_imports()), _gap)
    words = captions(page)
    left, right = min(layout.place[room] for room in ROOMS), max(layout.place[room] for room in ROOMS)
    shift, top = MARGIN + BOX_WIDTH / 2 - left, max(layout.row.values())
    at = {n: (x + shift, MARGIN + BOX_HEIGHT / 2 + ROW_HEIGHT * (top - layout.row[n])) for n, x in layout.place.items()}
    width, height = right - left + BOX_WIDTH + 2 * MARGIN, top * ROW_HEIGHT + BOX_HEIGHT + 2 * MARGIN
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}">',
            f"<style>{STYLE}</style>",
            '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
            '<path class="head" d="M0 0L8 4L0 8z"/></marker>',
            *(_arrow([at[name] for name in chain]) for chain in layout.chains),
            *(_box(room, words[room], *at[room]) for room in ROOMS),
            "</svg>\n",
        ]
    )


def _gap(a: str, b: str) -> float:
    """Return the least distance of two centres in a row; bends are points."""
    boxes = (a in ROOMS) + (b in ROOMS)
    return boxes * BOX_WIDTH / 2 + (GAP if boxes else BEND_GAP)


def _arrow(centres: list[tuple[float, float]]) -> str:
    """Return a curve from the foot of a box to the top of another; it passes the rows between them upright."""
    half = BOX_HEIGHT / 2
    path = f"M{centres[0][0]:.1f} {centres[0][1] + half:.1f}"
    for (x, y), (u, v) in pairwise(centres):
        middle = (y + v) / 2
        path += f"L{x:.1f} {y + half:.1f}C{x:.1f} {middle:.1f} {u:.1f} {middle:.1f} {u:.1f} {v - half:.1f}"
    return f'<path marker-end="url(#head)" d="{path}"/>'


def _box(name: str, caption: str, x: float, y: float) -> str:
    corner = f'x="{x - BOX_WIDTH / 2:.1f}" y="{y - BOX_HEIGHT / 2:.1f}"'
    return (
        f'<rect {corner} width="{BOX_WIDTH:.0f}" height="{BOX_HEIGHT:.0f}" rx="6"/>'
        f'<text class="name" x="{x:.1f}" y="{y - 4:.1f}">{escape(name)}</text>'
        f'<text class="what" x="{x:.1f}" y="{y + 13:.1f}">{escape(caption)}</text>'
    )


if __name__ == "__main__":
    DRAWING.write_text(draw(PAGE.read_text()))
    print(DRAWING)
