"""The rules that a checkpoint was trained for, and the names that it was trained under."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, get_type_hints

from dynahoi_lerobot.core.conventions import DETECTOR_IMAGE_SIZE_PX, EGO_VIEW
from dynahoi_lerobot.core.features import ENVIRONMENT_STATE, EYE, IMAGE_PREFIX
from dynahoi_lerobot.core.lerobot_internals import RENAMING_STEP
from dynahoi_lerobot.core.reading import ReadError, read_object, reading, require
from dynahoi_lerobot.evaluate.checkpoint_files import CONFIG, PIPELINES, TRAINING
from dynahoi_lerobot.renderers.views import OPTIONAL_VIEWS
from dynahoi_lerobot.rules import Rules

VIEW_KEYS = {view: IMAGE_PREFIX + view for view in (EGO_VIEW, *OPTIONAL_VIEWS)}
"""Keys of the images in datasets and environments, by view."""


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


def _rules_of_dataset(root: str | None) -> dict[str, Any]:
    """Return the rules of the dataset in ``root``, as far as there is one."""
    # its package brings in PyAV, which only checkpoints need
    from dynahoi_lerobot.dataset.manifest import Manifest

    with suppress(ReadError):
        return Manifest.read(Path(root)).rules if root else {}
    return {}
