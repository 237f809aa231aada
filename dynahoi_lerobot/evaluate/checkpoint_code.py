"""What in a checkpoint could run code while it is loaded.

LeRobot calls whatever importable object a processor step names, ``subprocess.Popen`` included.
``docs/notes/trust.md`` says what is refused here, and why.
"""

import inspect
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.reading import ReadError, inside, read_json, read_object
from dynahoi_lerobot.evaluate.checkpoint_files import ADAPTER, CONFIG, PIPELINES, PolicyError

POLICY_TYPES = frozenset(
    {
        "act",
        "actiontokens",
        "diffusion",
        "multi_task_dit",
        "obact",
        "pi0",
        "pi05",
        "smolvla",
        "tdmpc",
        "upvla",
        "vqbet",
        "xvla",
    }
)
"""Policies whose own code runs no Python files of the repositories that their configs name."""
STEPS = ("lerobot.policies.", "lerobot.processor.")
"""Modules whose processor steps a checkpoint may name without ``--trust``."""
LOADING_STEPS = "lerobot.processor.hil_processor"
"""One of them with a step that loads a second checkpoint."""
ADAPTER_KEYS = frozenset(
    {
        "alpha_pattern",
        "auto_mapping",
        "base_model_name_or_path",
        "bias",
        "exclude_modules",
        "fan_in_fan_out",
        "inference_mode",
        "init_lora_weights",
        "layers_pattern",
        "layers_to_transform",
        "lora_alpha",
        "lora_bias",
        "lora_dropout",
        "modules_to_save",
        "peft_type",
        "peft_version",
        "r",
        "rank_pattern",
        "revision",
        "target_modules",
        "task_type",
        "use_dora",
        "use_rslora",
    }
)
"""Keys of a LoRA adapter's config that say how layers change. Others name modules that PEFT would
import (``megatron_core``) or files that it would read."""
CODE_KEYS = {
    "auto_map": "has an auto_map, which names Python files to run",
    "trust_remote_code": "sets trust_remote_code, which runs Python files of a repository",
}
"""Keys by which transformers is told, at any depth, to run Python files of a repository."""
PICKLES = (".bin", ".pt", ".pth", ".pkl", ".ckpt")
"""Suffixes of files that Python unpickles, which runs what they hold; LeRobot's own checkpoints
have none."""


def code_in(folder: Path) -> Iterator[str]:
    """Yield what could run code while the checkpoint is loaded."""
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in PICKLES:
            yield f"{file} is a pickle, which runs code when it is opened"
        elif file.suffix == ".json":
            keys = {key for key, value in entries(read_json(file)) if key == "auto_map" or value}
            yield from (f"{file} {problem}" for key, problem in CODE_KEYS.items() if key in keys)
    kind = str(read_object(folder / CONFIG).get("type"))
    if kind not in POLICY_TYPES:
        yield (
            f"{folder / CONFIG} is of type {kind!r}, which is not on the list of policies "
            f"known to be safe"
        )
    if (folder / ADAPTER).exists():
        yield from _adapter_findings(folder / ADAPTER)
    _register_steps(kind)
    for file in (folder / name for name in PIPELINES):
        if file.exists():
            yield from (f"{file} {problem}" for problem in _pipeline_findings(file))


def _adapter_findings(file: Path) -> Iterator[str]:
    """Yield what of an adapter's config could make PEFT import modules or load further files."""
    try:
        from peft import LoraConfig
    except ImportError as error:
        raise PolicyError(f"playing the adapter {file.parent} needs peft ({error})") from error
    content = read_object(file)
    usual = vars(LoraConfig())
    if content.get("peft_type") != "LORA":
        yield f"{file} is of type {content.get('peft_type')!r}, not LORA"
    for key, value in content.items():
        if key not in ADAPTER_KEYS and value and value != usual.get(key):
            yield f"{file} sets {key}, which is not one of the keys known to be safe"


def _register_steps(kind: str) -> None:
    """Import what registers the processor steps of a type of policy."""
    try:
        from lerobot.policies.factory import get_policy_class
        from lerobot.utils.import_utils import register_third_party_plugins
    except ImportError as error:
        raise PolicyError(
            f"playing a policy needs LeRobot ({error}); install dynahoi_lerobot[lerobot]"
        ) from error
    register_third_party_plugins()
    with suppress(Exception):  # loading it will say what is wrong with the type
        get_policy_class(kind)


def _pipeline_findings(file: Path) -> Iterator[str]:
    from lerobot.processor import ProcessorStepRegistry

    for step in read_object(file, {"steps": list[dict[str, Any]]})["steps"]:
        name = step.get("registry_name", step.get("class"))
        config = step.get("config", {})
        if not isinstance(config, dict):
            raise PolicyError(
                f"{file} gives the step {name!r} the config {config!r}, which is no mapping"
            )
        registered = str(step.get("registry_name")) in ProcessorStepRegistry.list()
        kind: Any = ProcessorStepRegistry.get(step["registry_name"]) if registered else object
        if kind.__module__.startswith(STEPS) and kind.__module__ != LOADING_STEPS:
            yield from _step_findings(name, kind, config)
        else:
            yield f"names the processor step {name!r}, which is not one of those known to be safe"
        if "state_file" in step:
            state = step["state_file"]
            try:
                inside(file.parent, state)
            except ReadError:
                yield f"names the state file {state!r}, which is not inside the checkpoint"


def _step_findings(name: object, kind: Any, config: dict[str, Any]) -> Iterator[str]:
    """Yield what of a config one of LeRobot's own steps does not have, or would run code for."""
    parameters = inspect.signature(kind).parameters
    surplus = sorted(config.keys() - parameters.keys())
    if surplus:
        yield f"gives the step {name!r} the key {surplus[0]!r}, which it does not have"
        return
    if "trust_remote_code" in parameters and config.get("trust_remote_code") is not False:
        yield f"gives the step {name!r} no false trust_remote_code, so it may run Python files"


def entries(content: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value of JSON at any depth, with the key that it is below."""
    yield key, content
    if isinstance(content, dict | list):
        for name, value in (
            content.items() if isinstance(content, dict) else ((key, value) for value in content)
        ):
            yield from entries(value, name)


def refuse_remote_code() -> None:
    """Let transformers, if it is installed, refuse a repository with code of its own at once,
    instead of asking at the terminal whether to run it.
    """
    if find_spec("transformers"):
        from transformers import dynamic_module_utils

        dynamic_module_utils.TIME_OUT_REMOTE_CODE = 0  # [s] to wait for an answer
