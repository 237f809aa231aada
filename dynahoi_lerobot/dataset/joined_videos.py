"""The video files of a merged dataset, as few as the limits allow.

LeRobot's streaming reader reads images from the wrong file if a dataset has several, so those of the sources are
joined; one that stays alone is hard-linked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from dynahoi_lerobot.dataset.assembly import Assembly
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, video_columns
from dynahoi_lerobot.dataset.files import link
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.tables import MIB
from dynahoi_lerobot.dataset.video_copy import VideoCopy
from dynahoi_lerobot.features import CAMERA_KEY
from dynahoi_lerobot.foundation.conventions import CONTROL_HZ


@dataclass(frozen=True, eq=False)
class _Source:
    """The video files of some consecutive episodes, one for each view."""

    paths: dict[str, Path]
    digests: dict[str, str]
    n_frames: int


class JoinedVideos:
    """Copies the videos of several datasets and records where each episode's frames went."""

    def __init__(self, assembly: Assembly, stores: Sequence[Store], manifests: Sequence[Manifest]) -> None:
        """Copy or link them into ``assembly``."""
        self._places: dict[Path, tuple[EpisodeRow, int]] = {}
        pairs = zip(stores, manifests, strict=True)
        sources = [source for store, manifest in pairs if store.has_video for source in _sources(store, manifest)]
        for group in _groups(sources, assembly.limits):
            targets = assembly.next_videos()
            if len(group) == 1:
                _link(group[0], targets, assembly)
            else:
                _join(group, targets)
            first_frame = 0
            for source in group:
                self._places[source.paths[CAMERA_KEY]] = (assembly.video_place(), first_frame)
                first_frame += source.n_frames

    def place(self, store: Store, row: EpisodeRow) -> EpisodeRow:
        """Return the columns that say where an episode's frames are now; none without video."""
        if not store.has_video:
            return {}
        file, first_frame = self._places[store.video_path(row, CAMERA_KEY)]
        begin = first_frame + round(row[f"videos/{CAMERA_KEY}/from_timestamp"] * CONTROL_HZ)
        times = {"from_timestamp": begin / CONTROL_HZ, "to_timestamp": (begin + row["length"]) / CONTROL_HZ}
        return file | video_columns(store.pictures, times)


def _sources(store: Store, manifest: Manifest) -> Iterator[_Source]:
    """Yield the files of a dataset in the order of its episodes; those of all views are divided alike."""
    frames: dict[Path, int] = {}
    views: dict[Path, dict[str, Path]] = {}
    for row in store.full_rows():
        paths = {key: store.video_path(row, key) for key in store.pictures}
        views[paths[CAMERA_KEY]] = paths
        frames[paths[CAMERA_KEY]] = frames.get(paths[CAMERA_KEY], 0) + row["length"]
    for first, paths in views.items():
        digests = {key: manifest.files[path.relative_to(store.root).as_posix()] for key, path in paths.items()}
        yield _Source(paths, digests, frames[first])


def _groups(sources: Sequence[_Source], limits: FileLimits) -> list[list[_Source]]:
    """Return consecutive sources that go into one file together."""
    groups: list[list[_Source]] = []
    for source in sources:
        if groups and _fits([*groups[-1], source], limits):
            groups[-1].append(source)
        else:
            groups.append([source])
    return groups


def _fits(group: Sequence[_Source], limits: FileLimits) -> bool:
    sizes = [sum(source.paths[key].stat().st_size for source in group) for key in group[0].paths]
    seconds = sum(source.n_frames for source in group) / CONTROL_HZ
    return max(sizes) <= limits.video_mb * MIB and seconds <= limits.video_s


def _link(source: _Source, targets: dict[str, Path], assembly: Assembly) -> None:
    for key, target in targets.items():
        link(source.paths[key], target)
        assembly.set_known_hash(target, source.digests[key])


def _join(group: Sequence[_Source], targets: dict[str, Path]) -> None:
    for key, target in targets.items():
        copy = VideoCopy(target)
        for source in group:
            copy.open(source.paths[key])
            copy.frames(0, source.n_frames)
        copy.close()
