"""The fingerprint covers all code that decides the bytes of a dataset, and nothing that only reads datasets."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import dynahoi_lerobot
from dynahoi_lerobot.objects.ball import Ball
from dynahoi_lerobot.sampling.fingerprint import DECIDING_SOURCES, extension_fingerprint
from tests.test_imports import imports

PACKAGE = Path(dynahoi_lerobot.__file__).parent
ENTRY_POINTS = ("dynahoi_lerobot.generate.pipeline", "dynahoi_lerobot.rollout.loop")
REGISTRIES = ("objects", "motions", "hands", "captures", "experts", "renderers", "dataset/codecs")
"""Their modules are found by name and imported by nobody."""
SPREADS_WORK_ONLY = {"dynahoi_lerobot.generate.workers"}
"""Any number of processes gives the same bytes."""


def test_every_module_that_generation_imports_is_covered():
    paths = {name: name.removeprefix("dynahoi_lerobot.").replace(".", "/") + ".py" for name in reached()}
    assert len(paths) > 80
    missing = [name for name, path in paths.items() if "/" in path and not path.startswith(DECIDING_SOURCES)]
    assert set(missing) == SPREADS_WORK_ONLY


def test_everything_listed_exists():
    assert all((PACKAGE / name).exists() for name in DECIDING_SOURCES)


def test_readers_are_not_covered():
    assert not any(name.startswith(("vlm", "evaluate", "report", "adapters", "cli")) for name in DECIDING_SOURCES)


def test_code_of_others_counts_and_ours_is_not_counted_twice():
    class Theirs:
        pass

    assert extension_fingerprint([Ball]) == ""
    assert len(extension_fingerprint([Ball, Theirs])) == 16


def reached() -> set[str]:
    """Modules that generating a dataset imports, directly or not, and those that registries find."""
    edges: dict[str, set[str]] = defaultdict(set)
    for importing, imported in imports():
        edges[importing].add(imported)
    todo = [*ENTRY_POINTS, *(".".join(("dynahoi_lerobot", *p.parts)) for p in registered())]
    found: set[str] = set()
    while todo:
        module = todo.pop()
        if module.startswith("dynahoi_lerobot.") and module not in found:
            found.add(module)
            todo += edges[module]
    return found - {module for module in found if (PACKAGE / module.split(".", 1)[1].replace(".", "/")).is_dir()}


def registered() -> list[Path]:
    """Paths of the modules in the registries' folders, without their ending, relative to the package."""
    return [path.relative_to(PACKAGE).with_suffix("") for name in REGISTRIES for path in (PACKAGE / name).glob("*.py")]
