"""Merge datasets that this project wrote: join videos and renumber tables without decoding images.

LeRobot's streaming reader reads images from the wrong file if a dataset has several, so the videos of the sources are
joined, as far as the limits allow; one that stays alone is hard-linked.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
from av.packet import Packet
from av.video.stream import VideoStream

from dynahoi_lerobot.core.compatibility import refuse_to_mix
from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.features import CAMERA_KEY
from dynahoi_lerobot.dataset.assembly import Assembly, stored_episodes
from dynahoi_lerobot.dataset.columns import Features
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, video_columns
from dynahoi_lerobot.dataset.files import link, temporary_sibling
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.tables import MIB


class VideoCopy:
    """Appends frames of files of one encoding.

    An episode begins with a key frame and no codec here reorders frames, so its packets stand alone.
    """

    def __init__(self, target: Path) -> None:
        """Open ``target`` for writing."""
        self._output = av.open(str(target), "w", options={"fflags": "+bitexact"})
        self._stream: VideoStream | None = None
        self._written = 0

    def open(self, source: Path) -> None:
        """Take frames from ``source`` from now on, from its first one.

        Raises:
            OSError: if it cannot be read as a video.
        """
        self._source, self._read = source, 0
        stream = (container := av.open(str(source))).streams.video[0]
        self._packets: Iterator[Packet] = (packet for packet in container.demux(stream) if packet.size)
        if self._stream is None:
            self._stream = cast(VideoStream, self._output.add_stream_from_template(stream, opaque=True))
            self._stream.time_base = Fraction(1, CONTROL_HZ)

    def frames(self, start: int, count: int) -> tuple[int, int]:
        """Copy ``count`` frames from the source's frame ``start`` on; return where they begin and end here.

        Raises:
            ValueError: if the source is shorter than that.
        """
        begin = self._written
        for packet in itertools.islice(self._packets, start - self._read, start - self._read + count):
            packet.stream = cast(VideoStream, self._stream)
            packet.time_base = Fraction(1, CONTROL_HZ)
            packet.pts = packet.dts = self._written
            packet.duration = 1
            self._output.mux(packet)
            self._written += 1
        if self._written - begin < count:
            raise ValueError(f"{self._source} ends before frame {start + count}")
        self._read = start + count
        return begin, self._written

    def close(self) -> None:
        """Finish the file."""
        self._output.close()


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
