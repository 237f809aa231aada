"""Every file is there and has the hash that the manifest states."""

from __future__ import annotations

from collections.abc import Iterator

from dynahoi_lerobot.dataset.manifest import file_problems, stray_files
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, CheckedDataset


@CHECKS.register("files")
class Files(Check):
    """Compares the folder with the manifest, byte for byte."""

    def check_dataset(self, dataset: CheckedDataset) -> Iterator[str]:
        """Yield missing, changed and unknown files, and links."""
        if dataset.has_manifest:
            yield from file_problems(dataset.root, dataset.manifest)
            yield from stray_files(dataset.root, dataset.manifest.files)
        else:
            yield f"{MANIFEST_PATH} is missing, so no file can be compared with what was written"
