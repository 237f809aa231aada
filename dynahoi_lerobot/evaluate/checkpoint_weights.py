"""The weights of a checkpoint by their contents: what tells policies of the same name from one another."""

from __future__ import annotations

from pathlib import Path

from dynahoi_lerobot.foundation.digest import sha256

PATTERN = "*.safetensors"


def folder_weights(folder: Path) -> dict[str, str]:
    """Return the sha256 of every file of weights in a ``pretrained_model`` folder, by name."""
    return {path.name: sha256(path) for path in sorted(folder.glob(PATTERN)) if path.is_file()}
