"""The dataset card, ``README.md``, and its histograms. The same dataset gives the same bytes."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from dynahoi_lerobot.core.control_mode import CONTROL_MODES, GRASP, JOINTS
from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.escaping import markdown
from dynahoi_lerobot.core.features import Feature
from dynahoi_lerobot.dataset.columns import LANGUAGE, described_features
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import CARD_PATH, CODEBASE_VERSION, HISTOGRAM_PATH
from dynahoi_lerobot.dataset.store import Store, frame_column

if TYPE_CHECKING:
    from jinja2 import Template

METADATA = {
    "license": "apache-2.0",
    "task_categories": ["robotics"],
    "tags": ["LeRobot", "dynahoi", "robotics", "dexterous-manipulation", "simulation", "mujoco"],
    "configs": [{"config_name": "default", "data_files": "data/*/*.parquet"}],
}
"""What the Hub's search and viewer read."""
BOOKKEEPING_COLUMNS = {
    "timestamp": ("s", "time of the frame in its episode"),
    "frame_index": ("1", "number of the frame in its episode"),
    "episode_index": ("1", "number of the episode"),
    "index": ("1", "number of the frame in the dataset"),
    LANGUAGE: (
        "s",
        "subtasks, each with its timestamp: the same rows in every frame of an episode",
    ),
    "task_index": ("1", "number of the instruction in `meta/tasks.parquet`"),
}
"""Unit and meaning of LeRobot's own columns."""
DRAWN = ("action", "observation.state")
"""Columns whose histograms are drawn."""
BINS = 50
SIZES = {
    "n<1K": 10**3,
    "1K<n<10K": 10**4,
    "10K<n<100K": 10**5,
    "100K<n<1M": 10**6,
    "1M<n<10M": 10**7,
    "10M<n<100M": 10**8,
}
"""Numbers of rows at which the Hub's names for sizes end."""


def write_card(store: Store, manifest: Manifest) -> None:
    """Write the card and its histograms of a dataset that lacks only these and the manifest, which
    lists no files.
    """
    histograms = {key: HISTOGRAM_PATH.format(key=key) for key in DRAWN}
    for key, name in histograms.items():
        path = store.root / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(
            histogram_svg(frame_column(store.root, key), store.features[key]["names"]),
            encoding="utf-8",
        )
    metadata = METADATA | {"size_categories": [_size_category(manifest.frames)]}
    template = markdown_template(Path(__file__).with_suffix(".md").read_text())
    described = described_features(store.features)
    names = described["action"].names
    meanings = {
        key: (feature.unit, feature.meaning) for key, feature in described.items()
    } | BOOKKEEPING_COLUMNS
    text = template.render(
        metadata=yaml.safe_dump(metadata, sort_keys=False).rstrip(),
        manifest=manifest,
        control_mode=GRASP if names == CONTROL_MODES[GRASP] else JOINTS,
        action_size=len(names),
        recording=manifest.provenance.get("recording", {}),
        yields=manifest.yields,
        provenance=yaml.safe_dump(manifest.provenance, sort_keys=False).replace("```", "'''"),
        fps=CONTROL_HZ,
        version=CODEBASE_VERSION,
        successes=sum(row["success"] for row in store.rows),
        motions=_counts(store, "motion"),
        objects=_counts(store, "object"),
        histograms=histograms,
        frame_columns=[
            _cells(key, entry["dtype"], entry["shape"], *meanings.get(key, ("", _names(entry))))
            for key, entry in store.features.items()
        ],
        privileged={
            by_frame: [
                _cells(f.key, f.dtype, _privileged_shape(f), f.unit, f.meaning)
                for f in store.privileged.features
                if (f.per == "frame") == by_frame
            ]
            for by_frame in (True, False)
        },
    )
    (store.root / CARD_PATH).write_text(text, encoding="utf-8")


def markdown_template(text: str) -> Template:
    """Return a template that escapes its values, unless the template calls them safe."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined,
        finalize=lambda value: markdown(value) if type(value) is str else value,
    )
    return environment.from_string(text)


def _counts(store: Store, column: str) -> dict[str, tuple[int, int]]:
    """Return the number of episodes and of successes by value of a column of the episode table."""
    episodes = Counter(row[column] for row in store.rows)
    successes = Counter(row[column] for row in store.rows if row["success"])
    return {name: (episodes[name], successes[name]) for name in sorted(episodes)}


def _privileged_shape(feature: Feature) -> Sequence[object]:
    return ("n", *feature.shape) if feature.is_ragged else feature.column_shape


def _names(entry: dict[str, Any]) -> str:
    """Return the names of the elements of a column that no feature describes, such as a sensor's
    sightings.
    """
    return markdown(", ".join(map(str, entry["names"] or ())))


def _cells(key: str, dtype: str, shape: Sequence[object], unit: str, meaning: str) -> list[str]:
    from markupsafe import Markup

    return [key, dtype, " x ".join(map(str, shape)), Markup(unit), Markup(meaning)]


def _size_category(rows: int) -> str:
    """Return the Hub's name for this number of rows."""
    return next((name for name, end in SIZES.items() if rows < end), "n>100M")


COLUMNS = 6
"""Panels in a row."""
WIDTH = 130
HEIGHT = 60
"""Of the bars of a panel [px]."""
TOP = 16
BOTTOM = 14
"""Lines of text above and below them [px]."""
GAP = 10
"""Space between panels [px]."""
INK = "#4477aa"
TEXT = "#888888"
"""Colors that are legible on the Hub's light and dark pages."""


def histogram_svg(values: np.ndarray, names: Sequence[str]) -> str:
    """Return a panel for each dimension of (N, D) values; any version of any library draws the same
    bytes.
    """
    panels = [_panel(name, column) for name, column in zip(names, values.T, strict=True)]
    placed = [
        f'<g transform="translate({GAP + number % COLUMNS * (WIDTH + GAP)},'
        f'{number // COLUMNS * (TOP + HEIGHT + BOTTOM + GAP)})">{panel}</g>'
        for number, panel in enumerate(panels)
    ]
    width = GAP + min(len(panels), COLUMNS) * (WIDTH + GAP)
    height = math.ceil(len(panels) / COLUMNS) * (TOP + HEIGHT + BOTTOM + GAP)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'font-family="sans-serif">'
    )
    return "\n".join([head, *placed, "</svg>", ""])


def _panel(name: str, values: np.ndarray) -> str:
    """Return the outline of the bars, whose heights grow with log(1 + count), and the ends of the
    range.
    """
    values = values[np.isfinite(values)]
    low = float(values.min(initial=np.inf))
    high = float(values.max(initial=-np.inf))
    counts, _ = np.histogram(values, BINS, (low, high) if high > low else None)
    baseline = TOP + HEIGHT
    tallest = math.log1p(counts.max()) or 1.0
    bars = (baseline - HEIGHT * math.log1p(count) / tallest for count in counts)
    outline = (
        f"M0,{baseline}"
        + "".join(f"V{bar:.1f}h{WIDTH / BINS:.2f}" for bar in bars)
        + f"V{baseline}Z"
    )
    label = f'font-size="9" fill="{TEXT}" y="{baseline + 11}"'
    return (
        f'<text x="0" y="{TOP - 4}" font-size="11" fill="{TEXT}">{html.escape(str(name))}</text>'
        f'<path d="{outline}" fill="{INK}"/>'
        f'<text x="0" {label}>{low:.3g}</text><text x="{WIDTH}" {label} '
        f'text-anchor="end">{high:.3g}</text>'
    )
