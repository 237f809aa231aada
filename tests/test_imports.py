"""How the core hangs together: rooms import in one direction only, and none brings in torch or
LeRobot.
"""

import ast
import re
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import pytest

import dynahoi_lerobot
from tests.tools import python

PACKAGE = Path(dynahoi_lerobot.__file__).parent
ROOMS = (
    "core",
    "objects",
    "motions",
    "hands",
    "scene",
    "renderers",
    "captures",
    "metrics",
    "rules",
    "experts",
    "world",
    "sampling",
    "rollout",
    "env",
    "dataset",
    "verify",
    "encode",
    "vlm",
    "evaluate",
    "generate",
    "pretrain",
    "hub",
    "report",
    "play",
    "doctor",
    "cli",
)
"""Folders and modules of the package, in the order in which they may import each other: each only
those before it."""
LEARNED = ("dynahoi_lerobot.env.stable_baselines",)
"""What adapts to Stable-Baselines3, and so imports torch; others import it in functions alone."""
DOCUMENTED = {
    "lerobot.configs",
    "lerobot.datasets.dataset_metadata",
    "lerobot.datasets.dataset_tools",
    "lerobot.datasets.lerobot_dataset",
    "lerobot.envs.configs",
    "lerobot.policies.factory",
    "lerobot.processor",
    "lerobot.robots",
    "lerobot.teleoperators",
    "lerobot.utils.constants",
    "lerobot.utils.errors",
    "lerobot.utils.import_utils",
}
"""Modules of LeRobot that its documentation tells plugins to import."""
OBACT = "lerobot_policy_obact/lerobot_policy_obact"
TAUGHT = {f"{OBACT}/eye/pretraining", f"{OBACT}/eye/run_folder", f"{OBACT}/grip"}
"""Modules of policies that import the core."""
PROGRAM = """
import importlib, pkgutil, sys
package, learned, *heavy = sys.argv[1:]
path = importlib.import_module(package).__path__
names = [m.name for m in pkgutil.walk_packages(path, package + ".")]
for name in names:
    if not name.endswith("__main__") and name not in learned.split(","):
        importlib.import_module(name)
    if found := {*heavy} & set(sys.modules):
        sys.exit(f"{name} imports {', '.join(sorted(found))}")
print(len(names))
"""
HEAVY = {
    "dynahoi_lerobot": ("torch", "lerobot"),
    "dynahoi_lerobot.dataset": (
        "mujoco",
        "mujoco_warp",
        "warp",
        "torch",
        "lerobot",
        "datasets",
        "pandas",
    ),
}
"""What no module of a package may import."""


def imports() -> Iterator[tuple[str, str]]:
    """Yield (importing, imported) module of every import within the core.

    Imports inside functions count; those for type checkers alone do not.
    """
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for name in imported(_run_time_nodes(ast.parse(path.read_text()))):
            yield module.removesuffix(".__init__"), name


def imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the modules that nodes import, and those of the core that they name in a text, as the
    commands are.
    """
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from filter(_is_module, (f"{node.module}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Constant) and _is_module(node.value):
            yield str(node.value)


def _run_time_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes of a module that are not below ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield node
            yield from _run_time_nodes(node)


def _is_module(value: object) -> bool:
    """Tell whether a constant is the dotted name of a module of the core."""
    if not isinstance(value, str) or not re.fullmatch(rf"{PACKAGE.name}(\.\w+)+", value):
        return False
    path = PACKAGE.parent.joinpath(*value.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def test_rooms_import_only_rooms_before_them():
    wrong = [
        f"{module} imports {imported}"
        for module, imported in imports()
        if module != "dynahoi_lerobot"
        and imported.startswith("dynahoi_lerobot.")
        and ROOMS.index(imported.split(".")[1]) > ROOMS.index(module.split(".")[1])
    ]
    assert not wrong, "\n".join(wrong)


def imports_from(packages: set[str], folder: Path, pattern: str) -> set[str]:
    """Return the modules below a folder that import any of the packages, without ``.py``."""
    return {
        path.relative_to(folder).with_suffix("").as_posix()
        for path in folder.glob(pattern)
        if packages & {name.partition(".")[0] for name in imported(_nodes(path))}
    }


def _nodes(path: Path) -> Iterator[ast.AST]:
    return ast.walk(ast.parse(path.read_text()))


def test_policies_import_nothing_of_the_core_but_for_training():
    root = PACKAGE.parent / "policies"
    found = imports_from({PACKAGE.name}, root, "*/lerobot_policy_*/**/*.py")
    assert found == TAUGHT


def test_the_core_imports_no_policy():
    policies = {path.name for path in (PACKAGE.parent / "policies").iterdir()}
    assert not imports_from(policies, PACKAGE, "**/*.py")


def test_what_lerobot_may_rename_is_imported_in_one_module():
    paths = {*PACKAGE.rglob("*.py"), *(PACKAGE.parent / "envs").rglob("*.py")}
    paths -= {PACKAGE / "core" / "lerobot_internals.py"}
    nodes = chain.from_iterable(map(_nodes, paths))
    found = {f"{node.module}" for node in nodes if isinstance(node, ast.ImportFrom)}
    assert {name for name in found if name.split(".")[0] == "lerobot"} <= DOCUMENTED


@pytest.mark.parametrize(
    ("package", "least"), [("dynahoi_lerobot", 100), ("dynahoi_lerobot.dataset", 8)]
)
def test_no_module_imports_what_is_heavy(package: str, least: int):
    said = python("-c", PROGRAM, package, ",".join(LEARNED), *HEAVY[package])
    assert int(said.split()[-1]) > least, "the walk must have found the modules"


ALWAYS = ("torch", "lerobot", "mujoco_warp")
DRAWING = ("pandas", "pyarrow", "matplotlib", "PIL", "jinja2")
USES = [
    (
        "import dynahoi_lerobot.evaluate.gif, dynahoi_lerobot.metrics, dynahoi_lerobot.report",
        DRAWING,
    ),
    ("main(['list', 'hands'])", ("warp", "pandas", "pyarrow")),
    (
        "main(['evaluate', '--policy', 'hold', '--episodes', '1', '--out', sys.argv[1]])",
        ("warp", "pandas", "av"),
    ),
    (
        "main(['generate', '--episodes', '1', '--image-size', '32', '--root', sys.argv[1]])",
        ("matplotlib",),
    ),
    (
        "gym.make('dynahoi_lerobot.env:dynahoi/lob-v0', image_size=0).reset(seed=0)",
        ("warp", "pyarrow", "cv2"),
    ),
]
"""What a process may do, and which packages it has no use for, besides ``ALWAYS``."""


@pytest.mark.parametrize(("use", "unused"), USES)
def test_what_a_process_does_not_use_is_not_imported(
    use: str, unused: tuple[str, ...], tmp_path: Path
) -> None:
    main = "from dynahoi_lerobot.cli.main import main"
    start = main if use.startswith("main") else "import gymnasium as gym"
    said = python("-c", f"import sys; {start}; {use}; print(*sys.modules)", str(tmp_path / "new"))
    assert not sorted({*ALWAYS, *unused} & set(said.splitlines()[-1].split()))
