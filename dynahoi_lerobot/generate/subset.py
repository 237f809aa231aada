"""Copy some episodes of a dataset: packets are copied, nothing is decoded or encoded.

LeRobot's own tools re-encode a video file that loses an episode, and drop the per-episode columns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
from av.container import OutputContainer
from av.video.stream import VideoStream

from dynahoi_lerobot.conventions import CONTROL_HZ
from dynahoi_lerobot.generate.assembly import Assembly, stored_episodes
from dynahoi_lerobot.generate.files import temporary_sibling
from dynahoi_lerobot.generate.layout import Layout
from dynahoi_lerobot.generate.manifest import Manifest
from dynahoi_lerobot.generate.rows import Row
from dynahoi_lerobot.generate.store import Store
from dynahoi_lerobot.spec import CAMERA_KEY


def copy_subset(root: Path, output: Path, episodes: Collection[int]) -> Manifest:
    """Copy the named episodes, in their order, to a new dataset; ``output`` appears when it is whole.

    Args:
        root: a dataset written by this project.
        output: a path that does not exist yet.
        episodes: indices of the episodes to keep.

    Raises:
        FileExistsError: if ``output`` exists.
        ValueError: if no episode is kept, or one does not exist.
    """
    store, kept = Store(root), set(episodes)
    if output.exists():
        raise FileExistsError(f"{output} exists; choose a new folder")
    if not kept:
        raise ValueError("no episode is kept; a dataset holds one or more")
    if unknown := sorted(kept - set(range(store.episodes))):
        raise ValueError(f"episode {unknown[0]} does not exist; {root} holds {store.episodes}")
    with temporary_sibling(output) as folder:
        assembly = Assembly(folder, store, Layout())
        cutter = _Cutter(assembly)
        for index, (row, table) in enumerate(stored_episodes(store)):
            if index in kept:
                place = cutter.cut(store.video_path(row), row) if store.has_video else {}
                assembly.add(row | place, table)
        cutter.close()
        provenance = Manifest.read(root).provenance
        return assembly.finish(provenance | {"kept": sorted(kept)}, {})


class _Cutter:
    """Copies episodes' packets; every source file with kept episodes gives one file.

    An episode begins with a key frame and no codec here reorders frames, so its packets stand alone.
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        self._source: Path | None = None
        self._packets: Iterator[av.Packet] = iter(())
        self._read = self._written = 0
        self._output: OutputContainer | None = None

    def cut(self, source: Path, row: Row) -> Row:
        """Copy one episode's packets; return the columns that say where they went."""
        if source != self._source:
            self._open(source)
        start = round(row[f"videos/{CAMERA_KEY}/from_timestamp"] * CONTROL_HZ)
        while self._read < start:
            next(self._packets)
            self._read += 1
        begin = self._written
        for _ in range(row["length"]):
            self._copy(next(self._packets))
        times = {"from_timestamp": begin / CONTROL_HZ, "to_timestamp": self._written / CONTROL_HZ}
        return self._assembly.video_place() | {f"videos/{CAMERA_KEY}/{name}": time for name, time in times.items()}

    def close(self) -> None:
        """Finish the current file."""
        if self._output is not None:
            self._output.close()

    def _open(self, source: Path) -> None:
        self.close()
        container = av.open(str(source))
        stream = container.streams.video[0]
        self._packets = (packet for packet in container.demux(stream) if packet.size)
        output = av.open(str(self._assembly.next_video()), "w", options={"fflags": "+bitexact"})
        self._stream = cast(VideoStream, output.add_stream_from_template(stream, opaque=True))
        self._stream.time_base = Fraction(1, CONTROL_HZ)
        self._output, self._source, self._read, self._written = output, source, 0, 0

    def _copy(self, packet: av.Packet) -> None:
        assert self._output is not None
        packet.stream = self._stream
        packet.time_base = Fraction(1, CONTROL_HZ)
        packet.pts = packet.dts = self._written
        packet.duration = 1
        self._output.mux(packet)
        self._read += 1
        self._written += 1
