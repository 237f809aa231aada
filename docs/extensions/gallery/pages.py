"""The text of the gallery's pages, made from the registries, the benchmark's page and the tests."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Sequence
from pathlib import Path

from docs.extensions.api_pages import reference
from docs.extensions.gallery import scores
from docs.extensions.gallery.pictures import can_be_drawn
from docs.extensions.gallery.ranges import DRAWS, Range, object_ranges, parameter_ranges
from docs.extensions.gallery.theory_tests import named_tests, sentence, sweeping_tests
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.motions import CATEGORIES, MOTIONS
from dynahoi_lerobot.objects import OBJECTS
from dynahoi_lerobot.renderers.camera_views import VIEWS
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.randomization import RANDOMIZATIONS

FOLDER = "gallery"
TOP = Path(__file__).parents[3]
ORPHAN = "---\norphan: true\n---\n\n"
"""Head of a page that the cards of its section lead to: in the contents of every page it would be too much."""
INTRODUCTIONS = {
    "motions": "How targets move. The hand's camera is on the left, the side camera on the right. The border is grey "
    "in the observation window and green once the target is localised. Every second frame is shown.",
    "objects": "What is caught. Size, mass and friction are drawn anew in every episode.",
    "hands": "What catches. All hands have the same 18 degrees of freedom, so datasets and policies keep their shapes.",
    "views": "What cameras record: colour, depth or segmentation, from the hand or from the side.",
    "appearances": "What `appearance` in a recipe, or `--appearance`, randomises beyond the default. Motions, "
    "instructions and commands stay the same.",
    "metrics": "What is measured. [The metrics](../../concepts/metrics.md) explains those of the paper. Plots show one "
    "episode for each of the 22 kinds of motion in `test`, class `standard`: dots grow with the number of episodes at "
    "a value, the line is the mean, and the number in brackets says how many episodes count.",
}
"""What the first page of each section says."""


def pages() -> dict[str, str]:
    """Return the text of every page by its path below ``docs``."""
    found = {f"{FOLDER}/index.md": _front()}
    for section, entries in sections().items():
        found[f"{FOLDER}/{section}/index.md"] = _index(section, list(entries))
        found |= {f"{FOLDER}/{section}/{name}.md": ORPHAN + text for name, text in entries.items()}
    return found


@functools.cache
def sections() -> dict[str, dict[str, str]]:
    """Return the text of the page of every entry, by section and name."""
    order = sorted(MOTIONS.names(), key=lambda kind: (list(CATEGORIES).index(MOTIONS[kind].category), kind))
    return {
        "motions": {kind: _motion(kind) for kind in order},
        "objects": {name: _object(name) for name in OBJECTS.names()},
        "hands": {name: _hand(name) for name in HANDS.names()},
        "views": {name: _view(name) for name in VIEWS},
        "appearances": {name: _appearance(name) for name in RANDOMIZATIONS},
        "metrics": {name: _metric(name) for name in METRICS.names()},
    }


def _motion(kind: str) -> str:
    motion = MOTIONS[kind]
    tier, periodicity = CATEGORIES[motion.category]
    bases = [cls for cls in motion.__mro__[:-1] if cls.__module__ not in ("dynahoi_lerobot.motions.base", "abc")]
    theory = [paragraph for cls in bases for paragraph in [_first_paragraph(cls)]]
    return _page(
        kind,
        f"![{kind}]({kind}.gif)",
        f"An object *{motion.phrase}*: {motion.category.replace('_', ' ')}, {tier} tier, {periodicity}; "
        f"{_splits('motion', kind)}.",
        "## Definition\n\n" + "\n\n".join(theory),
        "## Parameters\n\n" + _ranges(parameter_ranges(kind)),
        _objects_of(kind),
        _drawn_scores("motion", kind, MOTIONS[kind].category, "Of the whole category. "),
        _tests("motions", {kind, *(cls.__name__ for cls in bases)}),
        f"## Try it\n\n```bash\ndynahoi view --motion {kind} --split {_split('motion', kind)} --out {kind}.gif\n```",
        f"Code: {reference(motion)}",
    )


def _object(name: str) -> str:
    entry = OBJECTS[name]
    traits = " and ".join(trait for trait in ("rolls", "slides") if getattr(entry, trait)) or "neither rolls nor slides"
    kinds = [kind for kind in MOTIONS.names() if name in MOTIONS[kind].objects()]
    moved = ", ".join(f"[{kind}](../motions/{kind}.md)" for kind in kinds)
    return _page(
        name,
        f"![{name}]({name}.gif)",
        f"{_first_paragraph(entry)} It {traits}; {_splits('object', name)}.",
        "## What is drawn\n\n" + _ranges(object_ranges(name)),
        f"## Motions\n\n{'All kinds.' if len(kinds) == len(MOTIONS.names()) else moved}",
        _drawn_scores("object", name, name),
        _tests("objects", {name, entry.__name__}),
        f"Code: {reference(entry)}",
    )


def _hand(name: str) -> str:
    return _page(
        name,
        f"![{name}]({name}.gif)" if can_be_drawn(name) else "Its model is not part of this project: no picture.",
        inspect.getdoc(HANDS[name]) or "",
        inspect.cleandoc(inspect.getmodule(HANDS[name]).__doc__ or ""),
        _scores(BASELINES, f"{name} hand", SOURCE),
        _tests("hands", {name, HANDS[name].__name__}),
        f"Code: {reference(HANDS[name])}",
    )


def _view(name: str) -> str:
    camera, draw = VIEWS[name]
    seen = "the hand, and always recorded" if camera == "ego" else "a fixed place beside the hand's home"
    option = "" if name == "ego" else f"\n\nWith `--views {name}`, or `views: [{name}]` in a recipe."
    return _page(
        name,
        f"![{name}]({name}.gif)",
        f"From {seen}. {inspect.getdoc(draw)}{option}",
        _scores(TRACKER, name, SMALL_SOURCE) or "No checkpoint that ships reads it.",
        _tests("renderers", {name, draw.__name__}),
        f"## Try it\n\n```bash\ndynahoi view --motion lob --view {name} --out {name}.gif\n```",
        f"Code: {reference(draw)}",
    )


def _appearance(name: str) -> str:
    return _page(
        name,
        f"![four episodes as they are, and below with {name}]({name}.png)",
        f"{inspect.getdoc(RANDOMIZATIONS[name])} Above: the default; below: the same episodes with `{name}`.",
        _scores(TRACKER, name, f"Its eye learned from randomised looks, the rest from the default. {SMALL_SOURCE}"),
        _tests("sampling", {name, "RANDOMIZATIONS"}),
        f"## Try it\n\n```bash\ndynahoi generate --root data/{name} --episodes 8 --appearance {name}\n```",
    )


def _metric(name: str) -> str:
    metric = METRICS[name]
    table = scores.of_metric(name)
    return _page(
        name,
        metric.doc,
        f"Unit `{metric.unit}`, {metric.bounds[0]:g} to {metric.bounds[1]:g}; {metric.direction} is better; "
        f"tables give the {metric.aggregation} of {metric.condition or 'all episodes'}.",
        f"![{name} of privileged baselines]({name}.svg)",
        f"## {BASELINES}\n\n{_table(table)}\n\n{SOURCE}" if table else "",
        _tests("metrics", {name}),
        f"Code: {reference(metric.compute)}",
    )


BASELINES, TRACKER = "Scores of privileged baselines", "Scores of the tracker"
SOURCE = "On the 1,000 episodes of `test`; [the benchmark](../../benchmark.md) has all of them."
SMALL_SOURCE = "On the 110 episodes of `test_small`; [the benchmark](../../benchmark.md) has all of them."


def _scores(title: str, label: str, source: str) -> str:
    """Return the section on what is scored on a stratum or under a condition; nothing if no score is known."""
    table = scores.of_stratum(label)
    return f"## {title}\n\n{_table(table)}\n\n{source}" if table else ""


def _drawn_scores(noun: str, name: str, stratum: str, of_what: str = "") -> str:
    """Return the section on an entry that splits draw: what is scored, or that `test` does not play it."""
    splits = BENCHMARK.splits_with(noun, name)
    if "test" in splits:
        return _scores(BASELINES, stratum, of_what + SOURCE)
    played = f"It is held out: only {_named(splits)} plays it" if splits else "No split plays it"
    link = "[the benchmark](../../benchmark.md), whose scores are those of `test`"
    return f"## {BASELINES}\n\n{played}, so {link}, has none of it."


def _tests(room: str, words: set[str]) -> str:
    """Return the section that names the tests of an entry."""
    found = named_tests(room, words) | sweeping_tests(room)
    return "## Tests\n\n" + "\n".join(
        f"- {_link(path)}: {'; '.join(map(sentence, names))}" for path, names in found.items()
    )


def _link(path: Path) -> str:
    """Return a link from a page of the gallery to the site's page of a file."""
    return f"[{path.name}](../../files/{path.relative_to(TOP).as_posix()}.md)"


def _objects_of(kind: str) -> str:
    names = MOTIONS[kind].objects()
    links = ", ".join(f"[{name}](../objects/{name}.md)" for name in names)
    return f"## Objects\n\n{'All of them.' if names == OBJECTS.names() else links}"


def _ranges(rows: list[tuple[str, str, list[Range]]]) -> str:
    table = [["", "meaning", f"{DRAWS} draws"]]
    table += [
        [f"`{name}`", text, ", ".join(f"{low:.3g} to {high:.3g}" for low, high in spans)] for name, text, spans in rows
    ]
    return _table(table)


def _splits(noun: str, name: str) -> str:
    splits = BENCHMARK.splits_with(noun, name)
    if "train" in splits:
        return "in distribution"
    return f"held out for {_named(splits)}" if splits else "played by name only"


def _named(splits: Sequence[str]) -> str:
    return ", ".join(f"`{split}`" for split in splits)


def _split(noun: str, name: str) -> str:
    splits = BENCHMARK.splits_with(noun, name)
    return splits[0] if splits and "test" not in splits else "test"


def _first_paragraph(entry: object) -> str:
    return " ".join((inspect.getdoc(entry) or "").split("\n\n")[0].split())


def _page(title: str, *parts: str) -> str:
    return "\n\n".join([f"# {title}", *(part for part in parts if part)]) + "\n"


def _table(rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def _front() -> str:
    links = "\n".join(f"{section}/index" for section in INTRODUCTIONS)
    return f"# Gallery\n\nEverything that is registered, a page each.\n\n```{{toctree}}\n:maxdepth: 1\n\n{links}\n```\n"


def _index(section: str, names: list[str]) -> str:
    return _page(
        section.capitalize(),
        INTRODUCTIONS[section],
        "{.gallery}\n" + "\n".join(_card(section, name) for name in names),
    )


def _card(section: str, name: str) -> str:
    suffix = "svg" if section == "metrics" else "png"
    picture = "" if section == "hands" and not can_be_drawn(name) else f"![]({name}.{suffix})<br>"
    return f"- [{picture}{name}]({name}.md)"
