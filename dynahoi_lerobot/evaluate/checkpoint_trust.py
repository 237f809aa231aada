"""Checkpoints are code: what a policy checkpoint could run while it is loaded, found before anything of it is loaded.

LeRobot calls whatever importable object a processor step names, ``subprocess.Popen`` included, before it asks whether
that is a processor step. ``docs/notes/trust.md`` says what else is refused here, and why.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

CONFIG = "config.json"
OWN_PACKAGES = ("dynahoi_lerobot", "lerobot_env_dynahoi", "lerobot_policy_tracker", "lerobot_policy_actiontokens")
"""Packages whose processor steps may be named by class; all other steps must be registered with LeRobot."""

PICKLES = (".bin", ".pt", ".pth", ".pkl", ".ckpt")
"""Suffixes of files that Python unpickles, which runs what they hold; LeRobot's own checkpoints have none."""

REMOTE_CODE = re.compile(r"""trust_remote_code["']?\s*[=:]\s*True""")
"""Source code that lets transformers run Python files of a repository."""

REMEDY = "give a pretrained_model folder, a Hub repository (user/name), or one of the experts"


class PolicyError(ValueError):
    """A policy that cannot be loaded; the message says what was asked for and what would do."""


class UntrustedCheckpointError(PolicyError):
    """A checkpoint that would run code while it is loaded; the message names the file and what in it."""

    def __init__(self, file: Path, finding: str) -> None:
        """Take the offending file of the checkpoint and what is wrong with it."""
        super().__init__(f"{file} {finding}; give --trust only if you would run a program from the same source")


def trusted_checkpoint(path: str) -> str:
    """Return the folder of a checkpoint that has been checked, downloaded from the Hub if need be.

    Of a Hub repository the JSON files are fetched and checked first; the weights then come from the same commit, and
    nothing else of the repository is downloaded.

    Args:
        path: a ``pretrained_model`` folder, or a Hub repository id.

    Raises:
        PolicyError: if there is no such repository, or a file of the checkpoint cannot be read.
        UntrustedCheckpointError: if loading the checkpoint could run code of its own.
    """
    if Path(path).is_dir():
        check_folder(Path(path))
        return path
    described = _download(path, ["*.json"])
    check_folder(described)
    return str(_download(path, ["*.safetensors"], revision=described.name))


def check_folder(folder: Path) -> None:
    """Refuse a checkpoint folder that could run code or read other files while it is loaded.

    LeRobot's plugins must have been registered before, as their processor steps are known only then.

    Raises:
        PolicyError: if a JSON file cannot be read, or a pipeline is no list of processor steps.
        UntrustedCheckpointError: as the module says.
    """
    from lerobot.utils.constants import POLICY_POSTPROCESSOR_DEFAULT_NAME, POLICY_PREPROCESSOR_DEFAULT_NAME

    for file in _files(folder):
        if file.suffix.lower() in PICKLES:
            raise UntrustedCheckpointError(file, "is a pickle, which runs code when it is opened")
        if file.suffix == ".json":
            _check_json(file, _read_json(file))
    _check_policy_type(folder / CONFIG)
    for name in (POLICY_PREPROCESSOR_DEFAULT_NAME, POLICY_POSTPROCESSOR_DEFAULT_NAME):
        file = folder / f"{name}.json"
        if file.is_file():
            _check_pipeline(file)


def _download(repository: str, patterns: list[str], revision: str | None = None) -> Path:
    import huggingface_hub

    try:
        folder = huggingface_hub.snapshot_download(
            repository, revision=revision, allow_patterns=patterns, ignore_patterns=["*training_state*"]
        )
    except Exception as error:
        raise PolicyError(f"there is no policy {repository!r} ({type(error).__name__}); {REMEDY}") from error
    return Path(folder)


def _files(folder: Path) -> Iterator[Path]:
    """Yield every file of the checkpoint; refuse links that lead out of it."""
    boundary = _boundary(folder)
    for file in sorted(folder.rglob("*")):
        if not file.resolve().is_relative_to(boundary):
            raise UntrustedCheckpointError(file, "is a link that leads out of the checkpoint")
        if not file.is_dir():
            yield file


def _boundary(folder: Path) -> Path:
    """The folder itself; of a snapshot in the Hub's cache, whose files are links, that repository's cache."""
    whole = folder.resolve()
    cached = whole.parent.name == "snapshots" and whole.parents[1].name.startswith("models--")
    return whole.parents[1] if cached else whole


def _read_json(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PolicyError(f"{file} cannot be read as JSON ({type(error).__name__})") from error


def _check_json(file: Path, content: Any) -> None:
    """Refuse the keys by which transformers is told to run Python files of a repository, at any depth."""
    if isinstance(content, dict):
        if "auto_map" in content:
            raise UntrustedCheckpointError(file, "has an auto_map, which names Python files to run")
        if content.get("trust_remote_code"):
            raise UntrustedCheckpointError(file, "sets trust_remote_code, which runs Python files of a repository")
    if isinstance(content, dict | list):
        for value in content.values() if isinstance(content, dict) else content:
            _check_json(file, value)


def _check_policy_type(file: Path) -> None:
    """Import the policy's own modules, which register its processor steps; refuse types that run remote code."""
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class

    content = _read_json(file)
    name = content.get("type") if isinstance(content, dict) else None
    if not isinstance(name, str) or name not in PreTrainedConfig.get_known_choices():
        return  # nothing of it can be loaded, and LeRobot says so
    if _runs_remote_code(PreTrainedConfig.get_choice_class(name)):
        raise UntrustedCheckpointError(file, f"is of type {name!r}, which runs code of repositories that it names")
    try:
        get_policy_class(name)
    except ImportError as error:
        raise PolicyError(f"{file} is of type {name!r}, which cannot be imported ({error})") from error


def _check_pipeline(file: Path) -> None:
    content = _read_json(file)
    steps = content.get("steps") if isinstance(content, dict) else None
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise PolicyError(f"{file} holds no list of processor steps")
    for step in steps:
        _check_step(file, step)


def _check_step(file: Path, step: dict[str, Any]) -> None:
    name = step["registry_name"] if "registry_name" in step else step.get("class")
    step_class = _registered(name) if "registry_name" in step else _by_class(name)
    if step_class is None:
        raise UntrustedCheckpointError(
            file, f"names the processor step {name!r}, which is neither registered with LeRobot nor of this project"
        )
    config = step.get("config", {})
    if not isinstance(config, dict):
        raise PolicyError(f"{file} gives the step {name!r} the config {config!r}, which is no mapping")
    if _runs_remote_code(step_class) or ("trust_remote_code" not in config and _trusts_by_default(step_class)):
        raise UntrustedCheckpointError(file, f"names the step {name!r}, which runs code of a repository that it names")
    state = step.get("state_file")
    inside = isinstance(state, str) and (file.parent / state).resolve().is_relative_to(_boundary(file.parent))
    if state is not None and (not inside or Path(str(state)).is_absolute() or ".." in Path(str(state)).parts):
        raise UntrustedCheckpointError(file, f"names the state file {state!r}, which is not inside the checkpoint")


def _registered(name: Any) -> type | None:
    from lerobot.processor import ProcessorStepRegistry

    return ProcessorStepRegistry.get(name) if name in ProcessorStepRegistry.list() else None


def _by_class(path: Any) -> type | None:
    """Return the registered step, or the step of this project, that has this dotted path; import nothing else."""
    from lerobot.processor import ProcessorStep, ProcessorStepRegistry

    if not isinstance(path, str):
        return None
    registered = [ProcessorStepRegistry.get(name) for name in ProcessorStepRegistry.list()]
    known = {f"{step.__module__}.{step.__qualname__}": step for step in registered}
    if path in known or path.partition(".")[0] not in OWN_PACKAGES:
        return known.get(path)
    module, _, name = path.rpartition(".")
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError:
        return None
    own = isinstance(found, type) and issubclass(found, ProcessorStep)
    return found if own and found.__module__.partition(".")[0] in OWN_PACKAGES else None


def _trusts_by_default(step_class: type) -> bool:
    parameter = inspect.signature(step_class).parameters.get("trust_remote_code")
    return parameter is not None and bool(parameter.default)


def _runs_remote_code(of_policy: type) -> bool:
    """Tell whether the package of a policy's config or processor step asks transformers to run remote code."""
    if of_policy.__module__.startswith("lerobot.processor."):
        return False  # shared by all policies; the one step that does has a parameter for it
    return _package_runs_remote_code(Path(inspect.getfile(of_policy)).parent)


@functools.cache
def _package_runs_remote_code(folder: Path) -> bool:
    return any(REMOTE_CODE.search(file.read_text(encoding="utf-8")) for file in folder.rglob("*.py"))
