"""Merge datasets that this project wrote: join videos and renumber tables without decoding images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynahoi_lerobot.dataset.assembly import Assembly, stored_episodes
from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.files import temporary_sibling
from dynahoi_lerobot.dataset.joined_videos import JoinedVideos
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.foundation.mixing import refuse_to_mix


def merge(
    sources: Sequence[Path],
    root: Path,
    *,
    limits: FileLimits | None = None,
    provenance: dict[str, Any] | None = None,
    allow_version_mismatch: bool = False,
) -> Manifest:
    """Merge datasets, in the given order, into a new one; ``root`` appears when it is complete.

    Args:
        sources: folders of datasets written by this project.
        root: a path that does not exist yet.
        limits: file size limits.
        provenance: stored in the manifest: recipe, seed, encoding and code fingerprint.
        allow_version_mismatch: merge datasets of different versions of the benchmark; the manifest then names all.

    Raises:
        FileExistsError: if ``root`` exists.
        MixedError: if their versions of the benchmark differ, unless that is allowed.
        ValueError: if the datasets' features differ, or there are none.
    """
    if root.exists():
        raise FileExistsError(f"{root} exists; choose a new folder for the merged dataset")
    stores = [Store(source) for source in sources]
    if not stores:
        raise ValueError("there is nothing to merge; name one dataset or more")
    for store in stores[1:]:
        if differing := _differing(stores[0].features, store.features):
            raise ValueError(
                f"{store.root} has other features than {stores[0].root} ({', '.join(differing)}); merge datasets that "
                "were generated with the same options"
            )
    manifests = [Manifest.read(store.root) for store in stores]
    if not allow_version_mismatch:
        found = [(store.root, manifest.benchmark) for store, manifest in zip(stores, manifests, strict=True)]
        refuse_to_mix("benchmark", found, "merge datasets of one version, or pass allow_version_mismatch=True")
    yields: Counter[str] = Counter()
    with temporary_sibling(root) as folder:
        assembly = Assembly(folder, stores[0], limits or FileLimits())
        videos = JoinedVideos(assembly, stores, manifests)
        for store, manifest in zip(stores, manifests, strict=True):
            _append(assembly, store, videos)
            yields.update(manifest.yields)
        return assembly.finish(provenance or {}, dict(yields))


def _differing(first: Features, other: Features) -> list[str]:
    """Return the keys of the features that only one of two datasets has, or that are not the same in both."""
    return [key for key in sorted(first.keys() | other.keys()) if first.get(key) != other.get(key)]


def _append(assembly: Assembly, store: Store, videos: JoinedVideos) -> None:
    for row, table in stored_episodes(store):
        assembly.add(row | videos.place(store, row), table)
