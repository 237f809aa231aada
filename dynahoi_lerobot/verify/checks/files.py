"""Every file is there and has the hash that the manifest states."""

from __future__ import annotations

from collections.abc import Iterator

from dynahoi_lerobot.dataset.manifest import sha256
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset

OWNED = ("data/", "videos/", "meta/")
"""Folders in which no file may be that the manifest does not list."""


@CHECKS.register("files")
class Files(Check):
    """Compares the folder with the manifest, byte for byte."""

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield missing, changed and unknown files."""
        if not (dataset.root / MANIFEST_PATH).is_file():
            yield f"{MANIFEST_PATH} is missing, so no file can be compared with what was written"
            return
        expected = dataset.manifest.files
        for name, digest in expected.items():
            path = dataset.root / name
            if not path.is_file():
                yield f"{name} is missing"
            elif (found := sha256(path)) != digest:
                yield f"{name} has changed: its sha256 is {found[:12]}..., the manifest says {digest[:12]}..."
        present = (path.relative_to(dataset.root).as_posix() for path in dataset.root.rglob("*") if path.is_file())
        for name in sorted(set(present) - set(expected) - {MANIFEST_PATH}):
            if name.startswith(OWNED):
                yield f"{name} is not in the manifest"
