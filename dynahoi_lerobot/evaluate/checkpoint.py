"""Opening a checkpoint: what it could run is found before anything of it is loaded, and its weights
must fit.

LeRobot calls whatever importable object a processor step names, ``subprocess.Popen`` included, and
silently keeps random weights where a checkpoint has none. ``docs/notes/trust.md`` says what is
refused here, and why.
"""

import inspect
import logging
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from dynahoi_lerobot.core.conventions import DETECTOR_IMAGE_SIZE_PX, EGO_VIEW
from dynahoi_lerobot.core.escaping import shortened
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE, EYE, IMAGE_PREFIX
from dynahoi_lerobot.core.lerobot_internals import RENAMING_STEP
from dynahoi_lerobot.core.reading import (
    ReadError,
    inside,
    read_json,
    read_object,
    reading,
    require,
    sha256,
    tensor_shapes,
)  # fmt: skip
from dynahoi_lerobot.core.registry import suggestion
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.renderers.views import OPTIONAL_VIEWS
from dynahoi_lerobot.rules import Rules

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
TRAINING = "train_config.json"
PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")
ADAPTER = "adapter_config.json"
ADAPTER_WEIGHTS = "adapter_model.safetensors"
"""What a folder holds in place of ``WEIGHTS`` if a LoRA adapter was trained (``--peft.*``)."""
BASE = "base/"
"""Names of the files of weights of an adapter's base begin so."""

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
PLUGINS = {
    "obact": "lerobot_policy_obact",
    "actiontokens": "lerobot_policy_actiontokens",
    "upvla": "lerobot_policy_actiontokens",
}
"""Our distribution that brings a policy type."""
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
MOST = 10**4
"""Largest whole number in the config of a policy, ..."""
TIMES = 100
"""... unless the default of its class is large: a number may be so many times that."""
MOST_NESTED = 500_000
"""Largest whole number below a key of the config: vocabularies of language models have up to
262,144 entries."""
STATISTICS = {
    "MEAN_STD": ("mean", "std"),
    "MIN_MAX": ("min", "max"),
    "QUANTILES": ("q01", "q99"),
    "QUANTILE10": ("q10", "q90"),
}
"""What a normalizer reads, by its mode."""

CODE_KEYS = {
    "auto_map": "has an auto_map, which names Python files to run",
    "trust_remote_code": "sets trust_remote_code, which runs Python files of a repository",
}
"""Keys by which transformers is told, at any depth, to run Python files of a repository."""
PICKLES = (".bin", ".pt", ".pth", ".pkl", ".ckpt")
"""Suffixes of files that Python unpickles, which runs what they hold; LeRobot's own checkpoints
have none."""
CHECKOUT = Path(__file__).parents[2]
"""Where checkpoints ship, if this package lies in a checkout."""
VIEW_KEYS = {view: IMAGE_PREFIX + view for view in (EGO_VIEW, *OPTIONAL_VIEWS)}
"""Keys of the images in datasets and environments, by view."""
REMEDY = (
    "give a pretrained_model folder, a Hub repository (user/name), or a baseline that "
    "`dynahoi list experts` names"
)


class PolicyError(ReadError):
    """A policy that cannot be loaded, or could run code while it is; the message says what in it,
    and what would do.
    """


def checked_folder(path: str, *, trust: bool = False, revision: str | None = None) -> Path:
    """Return the folder of a checkpoint, downloaded from the Hub if need be, once nothing in it
    could run code.

    The JSON files of a Hub repository are downloaded and checked first; its weights then come from
    the same commit.

    Args:
        path: a ``pretrained_model`` folder, or a Hub repository id.
        trust: print what could run instead of refusing it.
        revision: of the repository; its newest if None.

    The base of an adapter is checked and downloaded in the same way.

    Raises:
        PolicyError: if there is no such policy, a file of it cannot be read, or loading it could
            run code, unless ``trust`` allows that.
    """
    described = described_folder(path, revision)
    if not (described / CONFIG).exists():
        raise PolicyError(
            f"{described} holds no policy (no {CONFIG}){hint_at_checkpoint(described)}"
        )
    for finding in _findings(described):
        if not trust:
            raise PolicyError(
                f"{finding}; give --trust only if you would run a program from the same source"
            )
        print(f"--trust: {finding}", file=sys.stderr)
    base = base_folder(described)
    if base is not None:
        if (base / ADAPTER).exists():
            raise PolicyError(f"{described / ADAPTER} adapts {base}, which is an adapter itself")
        name_of_base, its_revision = _named_base(described)
        checked_folder(name_of_base, trust=trust, revision=its_revision)
    if os.path.isdir(path):
        return described
    return _download(path, ["*"] if trust else ["*.safetensors"], revision=described.name)


def described_folder(path: str, revision: str | None = None) -> Path:
    """Return a folder with the JSON files of a checkpoint, of which nothing has been checked.

    Raises:
        PolicyError: if there is no such folder or repository.
    """
    if os.path.isdir(path):
        return Path(path)
    if path.count("/") != 1:
        hint = suggestion(path, EXPERTS.names())
        raise PolicyError(f"there is no policy {path!r}{hint}; {REMEDY}")
    return _download(path, ["*.json"], revision)


def base_folder(folder: Path) -> Path | None:
    """Return the folder of the checkpoint that an adapter in ``folder`` adapts, of which nothing
    has been checked; None if that holds no adapter.

    Raises:
        PolicyError: if there is no such checkpoint.
    """
    if not (folder / ADAPTER).exists():
        return None
    name, revision = _named_base(folder)
    try:
        return described_folder(name, revision)
    except PolicyError as error:
        raise PolicyError(
            f"{folder / ADAPTER} adapts {name!r}, which is in neither the current folder nor one "
            f"above {folder}, and no repository; put the checkpoint there, or its full path into "
            f"base_model_name_or_path"
        ) from error


def _named_base(folder: Path) -> tuple[str, str | None]:
    """Return path or repository of the base that an adapter names, and its revision.

    A relative path counts from where the training was started. That is the first of these that has
    it: the folders above the adapter, the current one, and the checkout, whose checkpoints it may
    name.
    """
    file = folder / ADAPTER
    content = {"revision": None} | read_object(file)
    with reading(file):
        require(content, {"base_model_name_or_path": str | None, "revision": str | None})
    name = content["base_model_name_or_path"]
    if not name:
        raise PolicyError(f"{file} names no base_model_name_or_path, which it adapts")
    places = [*folder.resolve().parents, Path(), CHECKOUT]
    existing = [str(place / name) for place in places if (place / name / CONFIG).is_file()]
    return (existing[0] if existing else name), content["revision"]


def load_policy(
    folder: Path, device: str | None = None, settings: Sequence[str] = (), *, trust: bool = False
) -> tuple[Any, Any, Any]:
    """Return the policy, preprocessor and postprocessor of a checked folder, loaded by LeRobot.

    Args:
        folder: of ``checked_folder``.
        device: torch device, the policy's own if None.
        settings: overrides of its config, ``KEY=VALUE`` each.
        trust: let transformers run Python files of the repositories that the config names.

    Raises:
        PolicyError: if LeRobot cannot load it, its weights are not exactly those of its policy, or
            a normalizer lacks statistics.
    """
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    if not trust:
        _refuse_remote_code()
    config = _config(folder, settings)
    config.device = device or config.device
    base = base_folder(folder)
    weights_folder = base or folder
    for file in {weights_folder / WEIGHTS, *folder.glob("*.safetensors")}:
        tensor_shapes(file)  # LeRobot would wait for a pipe, and read a damaged file last
    overrides = {"device_processor": {"device": str(config.device)}}
    try:
        with _quiet():
            policy_class = get_policy_class(config.type)
            policy = policy_class.from_pretrained(str(weights_folder), config=config).eval()
            weights = policy.state_dict()
            adapted = {} if base is None else _adapt(policy, folder)
        pipelines = make_pre_post_processors(
            config, pretrained_path=str(folder), preprocessor_overrides=overrides
        )
    except Exception as error:  # whatever a policy or a processor raises about a bad checkpoint
        raise PolicyError(f"{folder} cannot be loaded: {reason(error)}") from error
    # a base may hold an average of its weights as well, which an adapter does without
    _check_fit(weights, weights_folder / WEIGHTS, surplus_allowed=base is not None)
    if adapted:
        _check_fit(adapted, folder / ADAPTER_WEIGHTS)
    for name, pipeline in zip(PIPELINES, pipelines, strict=True):
        _check_statistics(folder / name, pipeline)
    return policy, *pipelines


def _adapt(policy: Any, folder: Path) -> dict[str, Any]:
    """Put the adapter in ``folder`` into a policy's layers; return the adapter's weights as they
    are stored, by name.
    """
    from peft import LoraConfig, PeftModel, get_peft_model_state_dict

    config: Any = LoraConfig.from_pretrained(str(folder))
    adapted = PeftModel.from_pretrained(policy, str(folder), config=config).eval()
    policy.reset()  # which may hold a copy of the layers without the adapter
    return get_peft_model_state_dict(adapted)


def folder_weights(folder: Path) -> dict[str, str]:
    """Return the sha256 of every file of weights in a ``pretrained_model`` folder, by name, and
    that of an adapter's base as ``base/NAME``.
    """
    base = base_folder(folder)
    weights = {path.name: sha256(path) for path in sorted(folder.glob("*.safetensors"))}
    return weights if base is None else weights | {BASE + WEIGHTS: sha256(base / WEIGHTS)}


def renamed(folder: Path) -> dict[str, str]:
    """Return LeRobot's rename map that a checkpoint was trained with: from the keys of datasets and
    environments to the policy's own.
    """
    file = folder / PIPELINES[0]
    steps = read_object(file, {"steps": list[dict[str, Any]]})["steps"] if file.exists() else []
    with reading(file):
        maps = [
            (step.get("config") or {}).get("rename_map") or {}
            for step in steps
            if step.get("registry_name") == RENAMING_STEP
        ]
        names = {old: new for one in maps for old, new in one.items()}
        require({"rename_map": names}, {"rename_map": dict[str, str]})
    return names


def trained_for(folder: Path, names: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the values of fields of `Rules` that a checkpoint was trained for, as far as it tells.

    They are those that its config holds, or else those of the dataset that ``train_config.json``
    names, if that is on this machine, or else those of its ``env``. What it sees of them its inputs
    say: views, size [px] of the images, and whether it reads an ``environment_state`` at all.

    Args:
        folder: a ``pretrained_model`` folder.
        names: the rename map; by default the checkpoint's own, see ``renamed``.
    """
    names = renamed(folder) if names is None else names
    config = _read_if_there(folder / CONFIG)
    training = _read_if_there(folder / TRAINING)
    with reading(folder / (TRAINING if training else CONFIG)):
        env = training.get("env") or {}
        root = (training.get("dataset") or {}).get("root")
        rules = config.get("rules") or _rules_of_dataset(root)
        if not rules and env.get("type") == "dynahoi":
            rules = env
        hints = get_type_hints(Rules)
        values = {name: rules[name] for name in hints if rules.get(name) is not None}
        require(values, {name: hints[name] for name in values})
        inputs = config.get("input_features") or {}
        seen = {key for key in VIEW_KEYS.values() if names.get(key, key) in inputs}
        values["views"] = tuple(view for view in OPTIONAL_VIEWS if VIEW_KEYS[view] in seen)
        cameras = [
            feature for key, feature in inputs.items() if key.startswith("observation.image")
        ]
        if not cameras:
            values.pop("image_size", None)
        elif not (names and "image_size" in values):
            # a policy that was made for other cameras keeps the shape of theirs, and resizes
            values["image_size"] = cameras[0]["shape"][-1]
        if ENVIRONMENT_STATE not in inputs:
            values["environment_state"] = ""
        elif values.get("environment_state") == EYE and not cameras:
            values["image_size"] = DETECTOR_IMAGE_SIZE_PX
    return values


def _read_if_there(file: Path) -> dict[str, Any]:
    """Return the object in a JSON file, an empty one if there is no such file."""
    return read_object(file) if file.exists() else {}


def hint_at_checkpoint(folder: Path) -> str:
    """Return the end of a message about a folder that is no checkpoint; empty if there is none
    below it.
    """
    nested = sorted(folder.glob(f"**/pretrained_model/{CONFIG}"))
    return f"; did you mean {nested[-1].parent}?" if nested else ""


def _rules_of_dataset(root: str | None) -> dict[str, Any]:
    """Return the rules of the dataset in ``root``, as far as there is one."""
    # its package brings in PyAV, which only checkpoints need
    from dynahoi_lerobot.dataset.manifest import Manifest

    with suppress(ReadError):
        return Manifest.read(Path(root)).rules if root else {}
    return {}


def _download(repository: str, patterns: list[str], revision: str | None = None) -> Path:
    import huggingface_hub

    try:
        folder = huggingface_hub.snapshot_download(
            repository,
            revision=revision,
            allow_patterns=patterns,
            ignore_patterns=["*training_state*"],
        )
    except Exception as error:
        raise PolicyError(
            f"there is no policy {repository!r} ({type(error).__name__}); {REMEDY}"
        ) from error
    return Path(folder)


# -- what could run --------------------------------------------------------------------------------


def _findings(folder: Path) -> Iterator[str]:
    """Yield what could run code while the checkpoint is loaded."""
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in PICKLES:
            yield f"{file} is a pickle, which runs code when it is opened"
        elif file.suffix == ".json":
            keys = {key for key, value in _entries(read_json(file)) if key == "auto_map" or value}
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


def _entries(content: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value of JSON at any depth, with the key that it is below."""
    yield key, content
    if isinstance(content, dict | list):
        for name, value in (
            content.items() if isinstance(content, dict) else ((key, value) for value in content)
        ):
            yield from _entries(value, name)


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


def _refuse_remote_code() -> None:
    """Let transformers, if it is installed, refuse a repository with code of its own at once,
    instead of asking at the terminal whether to run it.
    """
    if find_spec("transformers"):
        from transformers import dynamic_module_utils

        dynamic_module_utils.TIME_OUT_REMOTE_CODE = 0  # [s] to wait for an answer


# -- what does not fit -----------------------------------------------------------------------------


def _config(folder: Path, settings: Sequence[str]) -> Any:
    """Open the config, with ``settings`` through LeRobot's own parser."""
    from lerobot.configs import PreTrainedConfig

    file = folder / CONFIG
    content = read_object(file)
    kind = content.get("type")
    if kind not in PreTrainedConfig.get_known_choices():
        package = PLUGINS.get(str(kind), f"lerobot_policy_{kind}")
        raise PolicyError(f"{file} is of type {kind!r}, which is not installed: install {package}")
    defaults = {
        entry.name: entry.default for entry in fields(PreTrainedConfig.get_choice_class(str(kind)))
    }
    _check_sizes(file, content, defaults)
    for setting in settings:
        key, equals, _ = setting.partition("=")
        if not equals or key not in defaults:
            raise PolicyError(
                f"cannot set {setting!r}: must be KEY=VALUE, KEY one of {', '.join(defaults)}"
            )
    try:
        config = PreTrainedConfig.from_pretrained(str(folder))
    except Exception as error:
        raise PolicyError(f"{file} is no config of a policy: {reason(error)}") from error
    try:
        return config.from_pretrained(
            str(folder), cli_overrides=[f"--{setting}" for setting in settings]
        )
    except Exception as error:
        raise PolicyError(
            f"cannot set {', '.join(settings)}: {error.__cause__ or error}"
        ) from error


def _check_sizes(file: Path, content: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
    """Refuse a config with far larger numbers than the ``defaults`` of its class: a million layers
    take hours to build before it shows that the weights do not fit.
    """
    for name, value in content.items():
        default = defaults.get(name)
        most = max(MOST, TIMES * default) if type(default) is int else MOST
        if isinstance(value, list | dict):
            most = MOST_NESTED
        for _, number in _entries(value):
            if type(number) is int and number > most:
                raise PolicyError(f"{file} says {name} is {number}; it must be {most} or less")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep LeRobot and torch from warning of weights that `_check_fit` refuses."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(before)


def _check_fit(state: Mapping[str, Any], file: Path, *, surplus_allowed: bool = False) -> None:
    """Refuse a file whose weights are missing, surplus or of another shape; of tied weights it
    holds one.
    """
    # LeRobot's Pi policies add the prefix when they load
    weights = {name.removeprefix("model."): tensor for name, tensor in state.items()}
    shapes = {name.removeprefix("model."): shape for name, shape in tensor_shapes(file).items()}
    both = [name for name in weights if name in shapes]
    tied = {weights[name].data_ptr() for name in both}
    problems = {
        "lacks": [
            name
            for name, tensor in weights.items()
            if name not in shapes and tensor.data_ptr() not in tied
        ],
        "has surplus": [] if surplus_allowed else [name for name in shapes if name not in weights],
        "has misshapen": [name for name in both if tuple(weights[name].shape) != shapes[name]],
    }
    for problem, names in problems.items():
        if names:
            raise PolicyError(
                f"{file} {problem} weights for its config: {len(names)}, such as {names[0]}"
            )


def _check_statistics(file: Path, pipeline: Any) -> None:
    """Refuse a pipeline that normalizes a feature without its statistics."""
    for step in (step for step in pipeline.steps if hasattr(step, "norm_map")):
        chosen = getattr(step, "normalize_observation_keys", None)
        for key, feature in step.features.items():
            mode = step.norm_map.get(feature.type)
            if mode is None or (chosen is not None and key not in (*chosen, "action")):
                continue
            for name in STATISTICS.get(mode.value, ()):
                values = step.stats.get(key, {}).get(name, np.nan)
                if not _is_finite(values, feature.shape):
                    raise PolicyError(
                        f"{file} normalizes {key} by a {name} that is missing, not finite or not "
                        f"of its shape"
                    )


def _is_finite(values: Any, shape: Sequence[int]) -> bool:
    """Tell whether statistics are of a feature's shape, or of one that fits it, and finite."""
    try:
        return bool(np.isfinite(np.broadcast_to(values, tuple(shape))).all())
    except ValueError:
        return False


def reason(error: BaseException) -> str:
    """Return the error's root cause in one line."""
    return shortened(f"{type(error).__name__}: {error.__cause__ or error}", 300)
