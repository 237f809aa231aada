"""``meta/manifest.json``: hashes, seeds and provenance of a dataset, by which it is checked, resumed and merged."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from dynahoi_lerobot.dataset.metadata import write_json
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH

FORMAT = 1
BLOCK = 1 << 20


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
            ValueError: if it is not JSON, or of another format.
        """
        content = json.loads((root / MANIFEST_PATH).read_text())
        if content.pop("format", None) != FORMAT:
            raise ValueError(f"{root / MANIFEST_PATH} has an unknown format; format {FORMAT} is known")
        return cls(**content)


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
