"""Opening a checkpoint: what it could run is found before anything of it is loaded, and its weights must fit.

LeRobot calls whatever importable object a processor step names, ``subprocess.Popen`` included, and silently keeps
random weights where a checkpoint has none. ``docs/notes/trust.md`` says what is refused here, and why.
"""

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.control_mode import CONTROL_MODES, GRASP
from dynahoi_lerobot.core.conventions import DETECTOR_IMAGE_SIZE_PX
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE, EYE, IMAGE_PREFIX, environment_state_of
from dynahoi_lerobot.core.files import printable, sha256

CONFIG, WEIGHTS, TRAINING = "config.json", "model.safetensors", "train_config.json"
PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")

POLICY_TYPES = frozenset(
    {"act", "actiontokens", "diffusion", "multi_task_dit", "obact", "pi0", "pi05", "smolvla", "tdmpc", "upvla"}
    | {"vqbet", "xvla"}
)
"""Policies whose own code runs no Python files of the repositories that their configs name."""

_NORMALIZER = frozenset({"features", "norm_map", "eps", "normalize_observation_keys"})
STEPS: dict[str, frozenset[str]] = {
    "absolute_actions_processor": frozenset({"enabled"}),
    "device_processor": frozenset({"device", "float_dtype"}),
    "normalizer_processor": _NORMALIZER,
    "observation_processor": frozenset(),
    "pi05_prepare_state_tokenizer_processor_step": frozenset({"max_state_dim", "task_key"}),
    "pi0_new_line_processor": frozenset(),
    "relative_actions_processor": frozenset({"enabled", "exclude_joints", "action_names"}),
    "rename_observations_processor": frozenset({"rename_map"}),
    "smolvla_new_line_processor": frozenset(),
    "to_batch_processor": frozenset(),
    "tokenizer_processor": frozenset(
        {"tokenizer_name", "max_length", "task_key", "padding_side", "padding", "truncation"}
    ),
    "unnormalizer_processor": _NORMALIZER,
    "xvla_add_domain_id": frozenset({"domain_id"}),
    "xvla_image_scale": frozenset({"image_keys"}),
    "xvla_image_to_float": frozenset({"image_keys", "validate_range"}),
    "xvla_imagenet_normalize": frozenset({"image_keys"}),
    "xvla_rotation_6d_to_axis_angle": frozenset({"expected_action_dim"}),
}
"""Processor steps that a checkpoint may name without ``--trust``, with the keys that their configs may have."""

STATE_FILE = re.compile(r"[\w.-]+\.safetensors")

PICKLES = (".bin", ".pt", ".pth", ".pkl", ".ckpt")
"""Suffixes of files that Python unpickles, which runs what they hold; LeRobot's own checkpoints have none."""
REMEDY = "give a pretrained_model folder, a Hub repository (user/name), or one of the experts"


class PolicyError(ValueError):
    """A policy that cannot be loaded, or could run code while it is; the message says what in it, and what would do."""


def checked_folder(path: str, *, trust: bool = False) -> Path:
    """Return the folder of a checkpoint, downloaded from the Hub if need be, once nothing in it could run code.

    The JSON files of a Hub repository are downloaded and checked first; its weights then come from the same commit.

    Args:
        path: a ``pretrained_model`` folder, or a Hub repository id.
        trust: print what could run instead of refusing it.

    Raises:
        PolicyError: if there is no such policy, a file of it cannot be read, or loading it could run code, unless
            ``trust`` allows that.
    """
    described = described_folder(path)
    if not (described / CONFIG).is_file():
        raise PolicyError(f"{described} holds no policy (no {CONFIG}){hint_at_checkpoint(described)}")
    for finding in _findings(described):
        if not trust:
            raise PolicyError(f"{finding}; give --trust only if you would run a program from the same source")
        print(f"--trust: {printable(finding)}", file=sys.stderr)
    if os.path.isdir(path):
        return described
    return _download(path, ["*"] if trust else ["*.safetensors"], revision=described.name)


def described_folder(path: str) -> Path:
    """Return a folder with the JSON files of a checkpoint, of which nothing has been checked.

    Raises:
        PolicyError: if there is no such folder or repository.
    """
    if os.path.isdir(path):
        return Path(path)
    if path.count("/") != 1:
        raise PolicyError(f"there is no policy {path!r}; {REMEDY}")
    return _download(path, ["*.json"])


def load_policy(folder: Path, device: str | None = None, settings: Sequence[str] = ()) -> tuple[Any, Any, Any]:
    """Return the policy, preprocessor and postprocessor of a checked folder, loaded by LeRobot.

    Args:
        folder: of ``checked_folder``.
        device: torch device, the policy's own if None.
        settings: overrides of its config, ``KEY=VALUE`` each.

    Raises:
        PolicyError: if LeRobot cannot load it, or its weights are not exactly those of its policy.
    """
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    config = _config(folder, settings)
    config.device = device or config.device
    shapes = _stored_shapes(folder / WEIGHTS)
    overrides = {"device_processor": {"device": str(config.device)}}
    try:
        policy = get_policy_class(config.type).from_pretrained(str(folder), config=config).eval()
        before, after = make_pre_post_processors(config, pretrained_path=str(folder), preprocessor_overrides=overrides)
    except Exception as error:  # whatever a policy or a processor raises when it is made from a bad checkpoint
        raise PolicyError(f"{folder} cannot be loaded: {reason(error)}") from error
    _check_fit(policy.state_dict(), shapes, folder)
    return policy, before, after


def folder_weights(folder: Path) -> dict[str, str]:
    """Return the sha256 of every file of weights in a ``pretrained_model`` folder, by name."""
    return {path.name: sha256(path) for path in sorted(folder.glob("*.safetensors"))}


def trained_for(folder: Path) -> dict[str, Any]:
    """Return what a checkpoint tells of the rules it was trained for: the values of some fields of `Recipe`.

    ``image_size`` [px] is that of the config's cameras, ``control_mode`` follows from the size of its actions. A policy
    of what the eye sees, told by the size of its input, needs the images that the eye learned from.
    ``capture``, ``control_class`` and ``protocol`` come from the recipe of the dataset that ``train_config.json``
    names, if that is on this machine, or else from its ``env``.
    """
    config, training = (_read_object(file) if (file := folder / name).is_file() else {} for name in (CONFIG, TRAINING))
    try:
        env, root = training.get("env") or {}, (training.get("dataset") or {}).get("root")
        rules = _recipe_of(root) or (env if env.get("type") == "dynahoi" else {})
        told = {key: rules[key] for key in ("capture", "control_class", "protocol") if rules.get(key)}
        inputs = config.get("input_features", {})
        if camera := next((feature for key, feature in inputs.items() if key.startswith(IMAGE_PREFIX)), None):
            told["image_size"] = camera["shape"][-1]
        if (state := inputs.get(ENVIRONMENT_STATE)) and environment_state_of(state["shape"]) == EYE:
            told |= {"environment_state": EYE, "image_size": DETECTOR_IMAGE_SIZE_PX}
        if config.get("output_features", {}).get("action", {}).get("shape") == [len(CONTROL_MODES[GRASP])]:
            told["control_mode"] = GRASP
    except (AttributeError, LookupError, TypeError) as error:
        raise PolicyError(f"{folder / CONFIG} or {TRAINING} is not as LeRobot writes it: {error}") from error
    return told


def hint_at_checkpoint(folder: Path) -> str:
    """Return the end of a message about a folder that is no checkpoint; empty if there is none below it."""
    nested = sorted(folder.glob(f"**/pretrained_model/{CONFIG}"))
    return f"; did you mean {nested[-1].parent}?" if nested else ""


def _recipe_of(root: str | None) -> dict[str, Any]:
    """Return the recipe of the dataset in ``root``, as far as there is one."""
    from dynahoi_lerobot.dataset.manifest import Manifest  # whose package brings in PyAV, which only checkpoints need

    try:
        return Manifest.read(Path(root)).provenance.get("recipe") or {} if root else {}
    except (OSError, ValueError):
        return {}


def _download(repository: str, patterns: list[str], revision: str | None = None) -> Path:
    import huggingface_hub

    try:
        folder = huggingface_hub.snapshot_download(
            repository, revision=revision, allow_patterns=patterns, ignore_patterns=["*training_state*"]
        )
    except Exception as error:
        raise PolicyError(f"there is no policy {repository!r} ({type(error).__name__}); {REMEDY}") from error
    return Path(folder)


# -- what could run ---------------------------------------------------------------------------------------------------


def _findings(folder: Path) -> Iterator[str]:
    """Yield what could run code while the checkpoint is loaded."""
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in PICKLES:
            yield f"{file} is a pickle, which runs code when it is opened"
        elif file.suffix == ".json":
            yield from (f"{file} {problem}" for problem in _remote_code(_read_json(file)))
    if (kind := str(_read_object(folder / CONFIG).get("type"))) not in POLICY_TYPES:
        yield f"{folder / CONFIG} is of type {kind!r}, which is not on the list of policies known to be safe"
    for file in (folder / name for name in PIPELINES):
        if file.is_file():
            yield from (f"{file} {problem}" for problem in _pipeline_findings(file))


def _remote_code(content: Any) -> Iterator[str]:
    """Yield the keys by which transformers is told to run Python files of a repository, at any depth."""
    if isinstance(content, dict):
        if "auto_map" in content:
            yield "has an auto_map, which names Python files to run"
        if content.get("trust_remote_code"):
            yield "sets trust_remote_code, which runs Python files of a repository"
    if isinstance(content, dict | list):
        for value in content.values() if isinstance(content, dict) else content:
            yield from _remote_code(value)


def _pipeline_findings(file: Path) -> Iterator[str]:
    steps = _read_object(file).get("steps")
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise PolicyError(f"{file} holds no list of processor steps")
    for step in steps:
        name, config = step.get("registry_name", step.get("class")), step.get("config", {})
        if not isinstance(config, dict):
            raise PolicyError(f"{file} gives the step {name!r} the config {config!r}, which is no mapping")
        known = STEPS.get(str(step.get("registry_name")))
        if known is None:
            yield f"names the processor step {name!r}, which is not on the list of steps known to be safe"
        elif surplus := sorted(config.keys() - known):
            yield f"gives the step {name!r} the key {surplus[0]!r}, which is not on the list of its keys"
        if (state := step.get("state_file")) is not None and not STATE_FILE.fullmatch(str(state)):
            yield f"names the state file {state!r}, which is not inside the checkpoint"


def _read_object(file: Path) -> dict[str, Any]:
    if not isinstance(content := _read_json(file), dict):
        raise PolicyError(f"{file} must hold a JSON object, not a {type(content).__name__}")
    return content


def _read_json(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PolicyError(f"{file} cannot be read as JSON ({type(error).__name__})") from error


# -- what does not fit ------------------------------------------------------------------------------------------------


def _config(folder: Path, settings: Sequence[str]) -> Any:
    """Open the config, with ``settings`` through LeRobot's own parser."""
    from lerobot.configs import PreTrainedConfig

    try:
        config = PreTrainedConfig.from_pretrained(str(folder))
    except Exception as error:
        raise PolicyError(f"{folder / CONFIG} is no config of a policy: {reason(error)}") from error
    known = [field.name for field in fields(config)]
    for setting in settings:
        key, equals, _ = setting.partition("=")
        if not equals or key not in known:
            raise PolicyError(f"cannot set {setting!r}: must be KEY=VALUE, KEY one of {', '.join(known)}")
    try:
        return config.from_pretrained(str(folder), cli_overrides=[f"--{setting}" for setting in settings])
    except Exception as error:
        raise PolicyError(f"cannot set {', '.join(settings)}: {error.__cause__ or error}") from error


def _stored_shapes(file: Path) -> dict[str, tuple[int, ...]]:
    """Return the shape of every tensor by name, from the file's header."""
    from safetensors import safe_open

    try:
        with safe_open(str(file), "numpy") as tensors:
            return {name: tuple(tensors.get_slice(name).get_shape()) for name in tensors.keys()}  # noqa: SIM118
    except Exception as error:  # the reader's own kinds of error differ from version to version
        raise PolicyError(f"{file} holds no weights ({error})") from error


def _check_fit(state: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], folder: Path) -> None:
    """Refuse weights that are missing, surplus or misshapen; of tied weights a file holds one."""
    wanted = {name.removeprefix("model."): tensor for name, tensor in state.items()}  # as LeRobot's Pi policies do
    stored = {name.removeprefix("model."): shape for name, shape in shapes.items()}
    tied = {tensor.data_ptr() for name, tensor in wanted.items() if name in stored}
    missing = [name for name, tensor in wanted.items() if name not in stored and tensor.data_ptr() not in tied]
    surplus = [name for name in stored if name not in wanted]
    misshapen = [name for name, shape in stored.items() if name in wanted and tuple(wanted[name].shape) != shape]
    for what, names in (("lacks", missing), ("has surplus", surplus), ("has misshapen", misshapen)):
        if names:
            raise PolicyError(f"{folder / WEIGHTS} {what} weights for its config: {len(names)}, such as {names[0]}")


def reason(error: BaseException) -> str:
    """Return the error's root cause in one line."""
    text = " ".join(f"{type(error).__name__}: {error.__cause__ or error}".split())
    return text if len(text) <= 300 else f"{text[:300]} ..."
