"""Histograms as handwritten SVG: the same numbers give the same bytes with any library version."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.sax.saxutils import escape

COLUMNS = 6
WIDTH, HEIGHT, TOP, BOTTOM, GAP = 130, 60, 16, 14, 10
"""Of one panel [px]: its bars, the line of text above and below them, and the space to the next one."""
INK, TEXT = "#4477aa", "#888888"
"""Legible on the Hub's light and dark pages."""


def histogram_svg(histograms: Mapping[str, Mapping[str, Any]]) -> str:
    """Return one panel per dimension, six in a row.

    Args:
        histograms: per dimension ``min`` and ``max`` in its unit and ``counts``, as in ``histograms.json``.
    """
    panels = [
        f'<g transform="translate({GAP + index % COLUMNS * (WIDTH + GAP)},'
        f'{index // COLUMNS * (TOP + HEIGHT + BOTTOM + GAP)})">{_panel(name, histogram)}</g>'
        for index, (name, histogram) in enumerate(histograms.items())
    ]
    width = GAP + min(len(panels), COLUMNS) * (WIDTH + GAP)
    height = math.ceil(len(panels) / COLUMNS) * (TOP + HEIGHT + BOTTOM + GAP)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif">'
    return "\n".join([head, *panels, "</svg>", ""])


def _panel(name: str, histogram: Mapping[str, Any]) -> str:
    low, high, baseline = histogram["min"], histogram["max"], TOP + HEIGHT
    return (
        f'<text x="0" y="{TOP - 4}" font-size="11" fill="{TEXT}">{escape(name)}</text>'
        f'<path d="{_outline(histogram["counts"])}" fill="{INK}"/>'
        f'<text x="0" y="{baseline + 11}" font-size="9" fill="{TEXT}">{low:.3g}</text>'
        f'<text x="{WIDTH}" y="{baseline + 11}" font-size="9" fill="{TEXT}" text-anchor="end">{high:.3g}</text>'
    )


def _outline(counts: Sequence[int]) -> str:
    """Return the path around the bars; their heights grow with log(1 + count), the largest fills the panel."""
    tallest, step, baseline = math.log1p(max(counts)) or 1.0, WIDTH / len(counts), TOP + HEIGHT
    tops = (baseline - HEIGHT * math.log1p(count) / tallest for count in counts)
    return f"M0,{baseline}" + "".join(f"V{top:.1f}h{step:.2f}" for top in tops) + f"V{baseline}Z"
