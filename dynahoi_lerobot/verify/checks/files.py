"""Every file is there and has the bytes that the manifest promises."""

from __future__ import annotations

from collections.abc import Iterator

from dynahoi_lerobot.dataset.manifest import sha256
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH
from dynahoi_lerobot.verify.checks.base import CHECKS, Check, Evidence

OWNED = ("data/", "videos/", "meta/")


@CHECKS.register("files")
class Files(Check):
    """Compares the folder with the manifest, byte for byte."""

    def dataset(self, evidence: Evidence) -> Iterator[str]:
        """Yield missing, changed and unknown files."""
        if not (evidence.root / MANIFEST_PATH).is_file():
            yield f"{MANIFEST_PATH} is missing, so no file can be compared with what was written"
            return
        promised = evidence.manifest.files
        for name, digest in promised.items():
            path = evidence.root / name
            if not path.is_file():
                yield f"{name} is missing"
            elif (found := sha256(path)) != digest:
                yield f"{name} has changed: its sha256 is {found[:12]}..., the manifest says {digest[:12]}..."
        present = (path.relative_to(evidence.root).as_posix() for path in evidence.root.rglob("*") if path.is_file())
        for name in sorted(set(present) - set(promised) - {MANIFEST_PATH}):
            if name.startswith(OWNED):
                yield f"{name} is not in the manifest"
