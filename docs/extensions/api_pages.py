"""Sphinx extension: one page of the API reference for each folder of the packages, with every public docstring."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.logging import getLogger

from docs.extensions.generated import write_pages
from docs.extensions.public_names import public_names, wrapped_definitions

logger = getLogger(__name__)
ROOT = Path(__file__).parents[2]
PACKAGES = {
    "dynahoi_lerobot": ROOT / "dynahoi_lerobot",
    "lerobot_env_dynahoi": ROOT / "envs/lerobot_env_dynahoi/lerobot_env_dynahoi",
    "lerobot_policy_tracker": ROOT / "policies/lerobot_policy_tracker/lerobot_policy_tracker",
    "lerobot_policy_actiontokens": ROOT / "policies/lerobot_policy_actiontokens/lerobot_policy_actiontokens",
}
"""Source folder of every distribution's package."""


def modules(package: str) -> dict[str, list[str]]:
    """Return the public modules of each folder of ``package`` by the folder's dotted name, itself first."""
    source, folders = PACKAGES[package], {}
    for path in sorted(source.rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        if any(part.startswith("_") and part != "__init__" for part in parts):
            continue
        folder = ".".join([package, *parts[:-1]])
        name = folder if parts[-1] == "__init__" else f"{folder}.{parts[-1]}"
        folders.setdefault(folder, []).append(name)
    return {folder: sorted(names, key=lambda name: (name != folder, name)) for folder, names in folders.items()}


def source_of(module: str) -> Path:
    """Return the source file of a module of the packages."""
    package, *parts = module.split(".")
    path = PACKAGES[package].joinpath(*parts)
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def folder_of(path: Path) -> str | None:
    """Return the dotted name of a package's folder of modules, if ``path`` is one."""
    for package, source in PACKAGES.items():
        if path.is_relative_to(source) and (path / "__init__.py").is_file():
            return ".".join([package, *path.relative_to(source).parts])
    return None


def reference(entry: Any) -> str:
    """Return a link, in MyST, to what the reference says of a class or a function."""
    return f"{{py:obj}}`{entry.__module__}.{entry.__qualname__}`"


def pages() -> dict[str, str]:
    """Return the text of every page of the reference by its path below ``docs``."""
    found = {}
    for package in PACKAGES:
        for folder, names in modules(package).items():
            found[f"api/{folder}.rst"] = _page(folder, names)
    found["api/index.md"] = _index()
    return found


def _page(folder: str, names: list[str]) -> str:
    return _title(folder, "=") + "\n".join(_section(folder, name) for name in names)


def _section(folder: str, name: str) -> str:
    title = "" if name == folder else _title(name.removeprefix(folder + "."), "-")
    return f"{title}.. automodule:: {name}\n{wrapped_definitions(name, source_of(name))}"


def _title(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n\n"


def _index() -> str:
    trees = "\n".join(
        f"```{{toctree}}\n:caption: {package}\n:maxdepth: 1\n\n{'\n'.join(modules(package))}\n```"
        for package in PACKAGES
    )
    return f"# API reference\n\nEvery public docstring, by package and folder.\n\n{trees}\n"


def missing(documented: set[str]) -> list[str]:
    """Return the public names with a docstring that are not among the ``documented`` ones."""
    names = [name for package in PACKAGES for group in modules(package).values() for name in group]
    return sorted(set().union(*(public_names(name, source_of(name)) for name in names)) - documented)


def _check(app: Sphinx, env: BuildEnvironment) -> None:
    for name in missing(set(env.domains.python_domain.objects)):
        logger.warning("the reference lacks %s", name)


def keep_colons(what: str, lines: list[str]) -> None:
    """Keep napoleon from taking what precedes a colon for the type, as it does in the first line of an attribute."""
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # an empty comment, which has no colon


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages when a build begins; warn of docstrings that none of them has."""
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir), "api", pages()))
    app.connect("env-check-consistency", _check)
    before_napoleon = 400  # its own priority is 500
    app.connect("autodoc-process-docstring", lambda *event: keep_colons(event[1], event[-1]), before_napoleon)
    return {"parallel_read_safe": True}
