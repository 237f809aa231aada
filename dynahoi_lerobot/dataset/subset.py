"""Copy some episodes of a dataset packet by packet, without decoding.

LeRobot's own tools re-encode a video file that loses an episode, and drop the per-episode columns.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.dataset.assembly import Assembly, stored_episodes
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, video_columns
from dynahoi_lerobot.dataset.files import reading, temporary_sibling
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.merge import VideoCopy
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH, FileLimits
from dynahoi_lerobot.dataset.store import Store


def copy_subset(root: Path, output: Path, episodes: Collection[int]) -> Manifest:
    """Copy the named episodes, in their order, to a new dataset; ``output`` appears when it is complete.

    Args:
        root: a dataset written by this project.
        output: a path that does not exist yet.
        episodes: indices of the episodes to keep.

    Raises:
        FileExistsError: if ``output`` exists.
        FileNotFoundError: if ``root`` holds no dataset of this project.
        ValueError: if no episode is kept, or one does not exist.
    """
    store, kept = Store(root), set(episodes)
    if output.exists():
        raise FileExistsError(f"{output} exists; choose a new folder")
    if not (root / MANIFEST_PATH).is_file():
        raise FileNotFoundError(f"{root} was not written by this project: {MANIFEST_PATH} is missing")
    with reading(root / MANIFEST_PATH):
        manifest = Manifest.read(root)
    if not kept:
        raise ValueError("got no episodes to keep; a dataset needs at least one")
    if unknown := sorted(kept - set(range(store.episodes))):
        raise ValueError(f"episode {unknown[0]} does not exist; {root} holds {store.episodes}")
    with temporary_sibling(output) as folder:
        assembly = Assembly(folder, store, FileLimits())
        cutter = _Cutter(assembly, store)
        for index, (row, table) in enumerate(stored_episodes(store)):
            if index in kept:
                place = cutter.cut(row) if store.has_video else {}
                assembly.add(row | place, table)
        cutter.close()
        provenance = manifest.provenance
        return assembly.finish(provenance | {"kept": sorted(kept)}, {})


class _Cutter:
    """Copies the video packets of episodes; each set of source files with kept episodes gives one set of new files."""

    def __init__(self, assembly: Assembly, store: Store) -> None:
        self._assembly, self._store = assembly, store
        self._sources: dict[str, Path] = {}
        self._copies: dict[str, VideoCopy] = {}

    def cut(self, row: EpisodeRow) -> EpisodeRow:
        """Copy one episode's packets; return the columns that say where they went."""
        sources = {key: self._store.video_path(row, key) for key in self._store.pictures}
        if sources != self._sources:
            self.close()
            targets = self._assembly.next_videos()
            self._copies = {key: VideoCopy(target) for key, target in targets.items()}
            for key, source in sources.items():
                self._copies[key].open(source)
            self._sources = sources
        times: EpisodeRow = {}
        for key, copy in self._copies.items():
            start = round(row[f"videos/{key}/from_timestamp"] * CONTROL_HZ)
            begin, end = copy.frames(start, row["length"])
            seconds = {"from_timestamp": begin / CONTROL_HZ, "to_timestamp": end / CONTROL_HZ}
            times |= video_columns([key], seconds)
        return self._assembly.video_place() | times

    def close(self) -> None:
        """Finish the current files."""
        for copy in self._copies.values():
            copy.close()
