"""Opening a checkpoint: nothing in it could run code, and its weights must fit.

LeRobot silently keeps random weights where a checkpoint has none.
"""

import logging
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynahoi_lerobot.core.escaping import printable, shortened
from dynahoi_lerobot.core.reading import read_object, tensor_shapes
from dynahoi_lerobot.evaluate.checkpoint_code import code_in, entries, refuse_remote_code
from dynahoi_lerobot.evaluate.checkpoint_files import (
    ADAPTER,
    ADAPTER_WEIGHTS,
    CONFIG,
    PIPELINES,
    WEIGHTS,
    PolicyError,
    base_folder,
    described_folder,
    download,
    hint_at_checkpoint,
    named_base,
)

PLUGINS = {
    "obact": "lerobot_policy_obact",
    "actiontokens": "lerobot_policy_actiontokens",
    "upvla": "lerobot_policy_actiontokens",
}
"""Our distribution that brings a policy type."""
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
    for finding in code_in(described):
        if not trust:
            raise PolicyError(
                f"{finding}; give --trust only if you would run a program from the same source"
            )
        print(f"--trust: {printable(finding)}", file=sys.stderr)
    base = base_folder(described)
    if base is not None:
        if (base / ADAPTER).exists():
            raise PolicyError(f"{described / ADAPTER} adapts {base}, which is an adapter itself")
        name_of_base, its_revision = named_base(described)
        checked_folder(name_of_base, trust=trust, revision=its_revision)
    if os.path.isdir(path):
        return described
    return download(path, ["*"] if trust else ["*.safetensors"], revision=described.name)


def load_policy(
    folder: Path, device: str | None = None, settings: Sequence[str] = (), *, trust: bool = False
) -> tuple[Any, Any, Any]:
    """Return the policy, preprocessor and postprocessor of a checked folder, loaded by LeRobot.

    Args:
        folder: of ``checked_folder``.
        device: torch device, the policy's own if None.
        settings: overrides of its config, ``KEY=VALUE`` each, or ``KEY.FIELD=VALUE`` for a field
            of a dataclass in it.
        trust: let transformers run Python files of the repositories that the config names.

    Raises:
        PolicyError: if LeRobot cannot load it, its weights are not exactly those of its policy, or
            a normalizer lacks statistics.
    """
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    if not trust:
        refuse_remote_code()
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
    _check_fit(weights, weights_folder / WEIGHTS)
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
    try:
        config = PreTrainedConfig.from_pretrained(str(folder))
    except Exception as error:
        raise PolicyError(f"{file} is no config of a policy: {reason(error)}") from error
    settable = _settable(config)
    for setting in settings:
        key, equals, _ = setting.partition("=")
        if not equals or key not in settable:
            raise PolicyError(
                f"cannot set {setting!r}: must be KEY=VALUE, KEY one of {', '.join(settable)}"
            )
    try:
        return config.from_pretrained(
            str(folder), cli_overrides=[f"--{setting}" for setting in settings]
        )
    except Exception as error:
        raise PolicyError(
            f"cannot set {', '.join(settings)}: {error.__cause__ or error}"
        ) from error


def _settable(config: Any) -> list[str]:
    """Return what can be set in a config: its fields, and those of dataclasses in it, ``a.b``."""
    names = []
    for entry in fields(config):
        names.append(entry.name)
        value = getattr(config, entry.name)
        if is_dataclass(value):
            names += [f"{entry.name}.{part.name}" for part in fields(value)]
    return names


def _check_sizes(file: Path, content: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
    """Refuse a config with far larger numbers than the ``defaults`` of its class: a million layers
    take hours to build before it shows that the weights do not fit.
    """
    for name, value in content.items():
        default = defaults.get(name)
        most = max(MOST, TIMES * default) if type(default) is int else MOST
        if isinstance(value, list | dict):
            most = MOST_NESTED
        for _, number in entries(value):
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


def _check_fit(state: Mapping[str, Any], file: Path) -> None:
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
        "has surplus": [name for name in shapes if name not in weights],
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
