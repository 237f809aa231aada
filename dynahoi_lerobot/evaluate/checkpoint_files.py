"""Where the files of a checkpoint are: in a folder, on the Hub, or with the base of an adapter.
Nothing here opens weights.
"""

import os
from pathlib import Path

from dynahoi_lerobot.core.reading import ReadError, read_object, reading, require, sha256
from dynahoi_lerobot.core.registry import suggestion
from dynahoi_lerobot.experts import EXPERTS

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
TRAINING = "train_config.json"
PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")
ADAPTER = "adapter_config.json"
ADAPTER_WEIGHTS = "adapter_model.safetensors"
"""What a folder holds in place of ``WEIGHTS`` if a LoRA adapter was trained (``--peft.*``)."""
BASE = "base/"
"""Names of the files of weights of an adapter's base begin so."""
CHECKOUT = Path(__file__).parents[2]
"""Where checkpoints ship, if this package lies in a checkout."""
REMEDY = (
    "give a pretrained_model folder, a Hub repository (user/name), or a baseline that "
    "`dynahoi list experts` names"
)


class PolicyError(ReadError):
    """A policy that cannot be loaded, or could run code while it is; the message says what in it,
    and what would do.
    """


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
    return download(path, ["*.json"], revision)


def base_folder(folder: Path) -> Path | None:
    """Return the folder of the checkpoint that an adapter in ``folder`` adapts, of which nothing
    has been checked; None if that holds no adapter.

    Raises:
        PolicyError: if there is no such checkpoint.
    """
    if not (folder / ADAPTER).exists():
        return None
    name, revision = named_base(folder)
    try:
        return described_folder(name, revision)
    except PolicyError as error:
        raise PolicyError(
            f"{folder / ADAPTER} adapts {name!r}, which is in neither the current folder nor one "
            f"above {folder}, and no repository; put the checkpoint there, or its full path into "
            f"base_model_name_or_path"
        ) from error


def named_base(folder: Path) -> tuple[str, str | None]:
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


def download(repository: str, patterns: list[str], revision: str | None = None) -> Path:
    """Download the files of a Hub repository that match ``patterns``, and return their folder.

    Raises:
        PolicyError: if there is no such repository, or it cannot be reached.
    """
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


def folder_weights(folder: Path) -> dict[str, str]:
    """Return the sha256 of every file of weights in a ``pretrained_model`` folder, by name, and
    that of an adapter's base as ``base/NAME``.
    """
    base = base_folder(folder)
    weights = {path.name: sha256(path) for path in sorted(folder.glob("*.safetensors"))}
    return weights if base is None else weights | {BASE + WEIGHTS: sha256(base / WEIGHTS)}


def hint_at_checkpoint(folder: Path) -> str:
    """Return the end of a message about a folder that is no checkpoint; empty if there is none
    below it.
    """
    nested = sorted(folder.glob(f"**/pretrained_model/{CONFIG}"))
    return f"; did you mean {nested[-1].parent}?" if nested else ""
