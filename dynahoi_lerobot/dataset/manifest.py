"""``meta/manifest.json``: hashes, seeds and provenance of a dataset, by which it is checked, resumed and merged."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from dynahoi_lerobot.dataset.metadata import write_json
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH

FORMAT = 1
BLOCK = 1 << 20
LISTED = ("data/", "videos/", "meta/")
"""Folders in which the manifest lists every file."""


@dataclass(frozen=True)
class Manifest:
    """What a dataset contains and where it comes from.

    Attributes:
        episodes: number of episodes.
        frames: number of frames.
        files: sha256 of every other file, by its path below the root.
        seeds: every episode's seed, in the dataset's order.
        provenance: recipe, seed, encoding and code fingerprint of the generation plan.
        yields: how many seeds were tried and how many were kept, missed or rejected.
    """

    episodes: int
    frames: int
    files: dict[str, str]
    seeds: list[int] = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    yields: dict[str, int] = field(default_factory=dict)

    def write(self, root: Path) -> None:
        """Write it below ``root``."""
        write_json({"format": FORMAT, **asdict(self)}, root / MANIFEST_PATH)

    @classmethod
    def read(cls, root: Path) -> Manifest:
        """Read it from below ``root``.

        Raises:
            OSError: if there is none.
            ValueError: if it is not JSON, or of another format.
        """
        content = json.loads((root / MANIFEST_PATH).read_text())
        names = {field.name for field in fields(cls)}
        if not isinstance(content, dict) or content.pop("format", None) != FORMAT or set(content) != names:
            raise ValueError(f"{root / MANIFEST_PATH} has an unknown format; format {FORMAT} is known")
        return cls(**content)


def file_problems(root: Path, manifest: Manifest) -> Iterator[str]:
    """Yield every file that is missing, has changed or is not in the manifest; every byte is read."""
    for name, digest in manifest.files.items():
        path = root / name
        if not path.is_file():
            yield f"{name} is missing"
        elif (found := sha256(path)) != digest:
            yield f"{name} has changed: its sha256 is {found[:12]}..., the manifest says {digest[:12]}..."
    present = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()}
    for name in sorted(present - set(manifest.files) - {MANIFEST_PATH}):
        if name.startswith(LISTED):
            yield f"{name} is not in the manifest"


def hash_files(root: Path, known: dict[str, str] | None = None) -> dict[str, str]:
    """Return the sha256 of every file below ``root`` but the manifest; ``known`` hashes are taken as they are."""
    names = (path.relative_to(root).as_posix() for path in sorted(root.rglob("*")) if path.is_file())
    known = known or {}
    return {name: known.get(name) or sha256(root / name) for name in names if name != MANIFEST_PATH}


def sha256(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()
