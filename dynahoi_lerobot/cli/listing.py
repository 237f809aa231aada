"""``dynahoi list``: the registries as tables, generated from the code."""

import inspect
import json
import shutil
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.arguments import argument, option
from dynahoi_lerobot.core.features import FEATURES, Feature, image_feature
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES, PROTOCOLS
from dynahoi_lerobot.core.registry import Registry
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.renderers import RENDERERS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

Row = dict[str, Any]


def _described(registry: Registry) -> Callable[[], list[Row]]:
    return lambda: [
        {"name": name, "description": _summary(entry)} for name, entry in registry.items()
    ]


def _motions() -> list[Row]:
    rows = []
    for name, kind in MOTIONS.items():
        tier, periodicity = CATEGORIES[kind.category]
        row = {
            "name": name,
            "category": kind.category,
            "tier": tier,
            "periodicity": periodicity,
            "splits": _splits("motion", name),
            "ranges": _summary(kind),
            "shared": _shared(kind),
        }
        rows.append(row)
    return sorted(rows, key=lambda row: (list(CATEGORIES).index(row["category"]), row["name"]))


def _objects() -> list[Row]:
    rows = []
    for name, entry in OBJECTS.items():
        traits = ", ".join(trait for trait in ("rolls", "slides") if getattr(entry, trait))
        row = {
            "name": name,
            "traits": traits,
            "splits": _splits("object", name),
            "description": _summary(entry),
        }
        rows.append(row)
    return rows


def _splits(noun: str, name: str) -> str:
    """Return the splits that contain a ``motion`` or an ``object``."""
    splits = BENCHMARK.splits_with(noun, name)
    return "in distribution" if "train" in splits else ", ".join(splits) or "by name only"


def _metrics() -> list[Row]:
    return [
        {
            "name": name,
            "unit": metric.unit,
            "better": metric.direction,
            "description": metric.summary,
        }
        for name, metric in METRICS.items()
    ]


def _control_classes() -> list[Row]:
    return [
        {
            "name": name,
            "palm": f"{control.palm_speed_m_s:g} m/s",
            "joints": f"{control.joint_speed_rad_s:g} rad/s",
            "latency": f"{control.latency_ms:g} ms",
        }
        for name, control in CONTROL_CLASSES.items()
    ]


def _protocols() -> list[Row]:
    return [{"name": name, "description": protocol.meaning} for name, protocol in PROTOCOLS.items()]


def _features() -> list[Row]:
    rows = [_feature(image_feature("*", 0), "H, W, 3")]
    return rows + [
        _feature(entry, ", ".join(map(str, entry.column_shape)) + ",")
        for entry in FEATURES.values()
    ]


def _feature(feature: Feature, shape: str) -> Row:
    cases = [
        (feature.per == "episode", "constant over the episode"),
        (feature.privileged, f"in meta/privileged{'' if feature.per == 'frame' else '_episodes'}"),
        (feature.is_ragged, f"a row per {feature.per}"),
        (feature.needs_contact_sensors, "only if the capture rule uses contact sensors"),
        (feature.on_request, "only on request"),
    ]
    notes = "; ".join(words for holds, words in cases if holds)
    return {
        "dataset": feature.key,
        "gymnasium": feature.gym_key or "privileged",
        "shape": f"({shape}) {feature.dtype}",
        "unit": "" if feature.unit == "1" else feature.unit,
        "meaning": f"{feature.meaning} ({notes})" if notes else feature.meaning,
    }


LISTS: dict[str, Callable[[], list[Row]]] = {
    "motions": _motions,
    "objects": _objects,
    "metrics": _metrics,
    "captures": _described(CAPTURES),
    "control-classes": _control_classes,
    "protocols": _protocols,
    "experts": _described(EXPERTS),
    "features": _features,
    "hands": lambda: [{"name": name, "description": hand.summary} for name, hand in HANDS.items()],
    "renderers": _described(RENDERERS),
}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi list``."""

    what: str = argument("registry to print", choices=sorted(LISTS))
    json: bool = option(False, "print JSON")


def run(options: Options) -> int:
    """Print a registry; return the exit code."""
    rows = LISTS[options.what]()
    width = shutil.get_terminal_size((100, 24)).columns
    print(json.dumps(rows, indent=2) if options.json else fitted(rows, width))
    return 0


INDENT = "    "


def fitted(rows: list[Row], width: int) -> str:
    """Return rows as a table, or, if that is wider than ``width`` characters, as paragraphs."""
    table = markdown_table(rows)
    if table.index("\n") <= width:
        return table
    name, *columns = rows[0]
    sentences = [key for key in columns if max(len(str(row[key])) for row in rows) > SHORT]
    lines = []
    for row in rows:
        words = [str(row[key]) for key in columns if key not in sentences and row[key]]
        lines.append(f"{row[name]}: {', '.join(words)}" if words else str(row[name]))
        for key in sentences:
            lines += textwrap.wrap(
                row[key],
                width,
                initial_indent=INDENT,
                subsequent_indent=INDENT,
                break_on_hyphens=False,
            )
    return "\n".join(lines)


SHORT = 24
"""Longest value [characters] of a column that stands beside the name; longer ones stand below."""


def markdown_table(rows: list[Row]) -> str:
    """Return rows as a Markdown table with aligned columns."""
    header = list(rows[0])
    cells = [header, *([str(row[key]) for key in header] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(header))]
    lines = [
        "| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |"
        for line in cells
    ]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def _summary(entry: Any) -> str:
    """Return the first paragraph of the docstring on one line."""
    return " ".join((inspect.getdoc(entry) or "").split("\n\n")[0].split())


def _shared(kind: type) -> str:
    """Return the summary of the class that several kinds share."""
    parent = kind.__mro__[1]
    return _summary(parent) if parent.__module__ != "dynahoi_lerobot.motions.base" else ""
