"""Second claim: everything below ``meta/`` follows from the episodes, and LeRobot reads them by it.

The writer writes it again from the frames and images that are stored, and what it writes is
compared.
"""

from collections.abc import Callable, Iterable, Iterator
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.compute as pc
from av.container import OutputContainer
from av.packet import Packet
from av.video.stream import VideoStream

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import IMAGE_PREFIX, privileged_features
from dynahoi_lerobot.core.reading import open_table, read_object, read_rows, read_table, validated
from dynahoi_lerobot.dataset.columns import LANGUAGE, described_features
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, row_stats
from dynahoi_lerobot.dataset.manifest import NOT_OURS, Manifest, has_own_card
from dynahoi_lerobot.dataset.merge import Opened, episode_packets
from dynahoi_lerobot.dataset.paths import CARD_PATH, MANIFEST_PATH, FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import Encoding, VideoFile
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.rollout.recording import Recording

EXACT = 1e-9
"""Numbers that differ by less, of them or of 1, are the same: another processor adds up in another
order."""
IMAGE_LEVELS = {
    "mean": 4,
    "std": 8,
    "q10": 24,
    "q50": 24,
    "q90": 24,
    "q01": 48,
    "q99": 48,
    "min": 96,
    "max": 96,
}
"""How far statistics of images before they were encoded may lie from those of the decoded ones
[levels of 255], with crf 23 or less; the greatest seen are 1.7, 3.6, 10, 12, 6, 31, 14, 27 and 54.
Video halves the resolution of colors."""
CRF, CRF_DOUBLES = 23, 12
"""Beyond this crf, this many steps double what is allowed (seen with crf 51: 7.8 for the mean, 17
for std)."""


def meta_problems(store: Store, manifest: Manifest) -> Iterator[str]:
    """Yield what the tables, the card and the manifest say otherwise than the writer makes of the
    stored episodes.
    """
    with (
        TemporaryDirectory() as scratch,
        _Again(Path(scratch) / "again", store, manifest) as writer,
    ):
        opened: dict[str, Opened] = {}
        seen: dict[bytes, int] = {}
        for index, stored in enumerate(store.stored_episodes()):
            episode = store.as_episode(stored, images=True)
            yield from _repeats(episode, index, seen)
            writer.repeat(episode, stored.row, episode_packets(store, stored.row, opened))
        made, own_card = (
            writer.finish(manifest.provenance, manifest.yields),
            has_own_card(store.root, manifest),
        )
        yield from _facts(manifest, made, sum(not row["success"] for row in store.rows))
        for name in sorted(
            {*made.files, *writer.videos, *manifest.files} - (set(NOT_OURS) - set(made.files))
        ):
            stored, again = store.root / name, writer.root / name
            if name not in made.files and name not in writer.videos:
                yield f"{name} is in the manifest, but no part of the dataset"
            elif name not in manifest.files:
                yield f"{name} is not in the manifest"
            elif name.endswith(".parquet"):
                yield from (
                    f"{name}{problem}" for problem in _table(stored, again, writer.tolerance)
                )
            elif name.endswith(".json"):
                yield from (
                    f"{name}{problem}"
                    for problem in _object(read_object(stored), read_object(again))
                )
            elif made.files.get(name, listed := manifest.files[name]) != listed and (
                name != CARD_PATH or own_card
            ):
                yield f"{name} is not what the card's template makes of the dataset"


def _facts(said: Manifest, made: Manifest, failed: int) -> Iterator[str]:
    """Yield what a manifest says otherwise than the episodes give."""
    for name in ("episodes", "frames", "seeds", "benchmark"):
        if (one := getattr(said, name)) != (other := getattr(made, name)):
            yield f"{MANIFEST_PATH} says {name} is {short(one)}; the episodes give {short(other)}"
    if (told := said.yields) or ("recording" in said.provenance and "kept" not in said.provenance):
        counts = {"kept": made.episodes, "failed": failed} | {
            name: told.get(name, 0) for name in ("missed", "rejected")
        }
        if told != (
            counts := counts | {"tried": made.episodes + counts["missed"] + counts["rejected"]}
        ):
            yield f"{MANIFEST_PATH} says yields is {short(told)}; the episodes give {short(counts)}"


class _Unwritten(VideoFile):
    """A video of which only the size is known."""

    def __init__(self) -> None:
        self.frames = self.size_bytes = 0

    def append(self, packets: Iterable[Packet]) -> None:
        """Count the packets of one episode."""
        for packet in packets:
            self.frames, self.size_bytes = self.frames + 1, self.size_bytes + packet.size

    def close(self) -> None:
        """Nothing was written."""

    abandon = close


class _Again(DatasetWriter):
    """Writes a stored dataset again, but for its videos, whose paths are in ``videos``.

    The manifest's plan tells its columns and settings; without one, the names of the columns and
    the recorded codec do.
    """

    def __init__(self, root: Path, store: Store, manifest: Manifest) -> None:
        plan, described = manifest.provenance, store.features
        if "recording" in plan:
            recording = validated(Recording, plan["recording"])
            columns = (*recording.recipe.rules.features, *privileged_features())
            encoding, subtasks = validated(Encoding, plan["encoding"]), plan["subtasks"]
        else:
            columns = (*described_features(described).values(), *store.privileged.features)
            encoding, subtasks = store.encoding, LANGUAGE in described
        super().__init__(
            root, columns, encoding, FileLimits(**plan.get("limits", {})), subtasks=subtasks
        )
        self.videos: set[str] = set()

    def repeat(self, episode: Episode, row: EpisodeRow, packets: dict[str, list[Packet]]) -> None:
        """Append a stored episode; the statistics of its images are compared with its own row
        only.
        """
        self.add(episode, packets)
        for key, found in self._image_stats.items():
            found[-1] = row_stats(row, key)

    def tolerance(self, column: str) -> float:
        """Return how far a column of the episode table may be from what decoded images give."""
        key, _, statistic = column.removeprefix("stats/").rpartition("/")
        if key not in self._video_keys:
            return 0.0
        doubled = max(0, self._encoding.crf - CRF) / CRF_DOUBLES
        return IMAGE_LEVELS.get(statistic, 0) / 255 * 2**doubled

    def _open_video(
        self, path: Path, add_stream: Callable[[OutputContainer], VideoStream]
    ) -> VideoFile:
        self.videos.add(path.relative_to(self.root).as_posix())
        return _Unwritten()


def _repeats(episode: Episode, index: int, seen: dict[bytes, int]) -> Iterator[str]:
    """Yield which earlier episode has the same facts, the same motion of hand and target, or the
    same images.
    """
    parts = {
        "facts": repr(episode.meta).encode(),
        "motion": episode.state.tobytes() + episode.target_pose_h.tobytes(),
        "images": b"".join(
            np.ascontiguousarray(images).tobytes() for images in episode.images.values()
        ),
    }
    for part, content in parts.items():
        if content and (before := seen.setdefault(sha256(content).digest(), index)) != index:
            yield f"episode {index} repeats the {part} of episode {before}"


def _table(stored: Path, again: Path, tolerance: Callable[[str], float]) -> Iterator[str]:
    """Yield how a table is other than it is made again; of images in it only the names are
    compared.
    """
    one, other = open_table(stored).schema_arrow, open_table(again).schema_arrow
    if not one.equals(other, check_metadata=True):
        yield f" has the columns {short(one)}; {short(other)} are made again"
        return
    if "length" in other.names:
        for index, rows in enumerate(
            zip_longest(read_rows(stored), read_rows(again), fillvalue={})
        ):
            for name in other.names:
                found, wanted = (row.get(name) for row in rows)
                if not alike(found, wanted, tolerance(name)):
                    yield (
                        f", row {index}: {name} is {short(found)}; {short(wanted)} follows "
                        f"from its frames and place"
                    )
        return
    found, wanted = read_table(stored), read_table(again)
    if len(found) != len(wanted):
        yield f" has {len(found)} rows, not {len(wanted)}"
        return
    for name in other.names:
        pair = [table[name] for table in (found, wanted)]
        if name.startswith(IMAGE_PREFIX):
            pair = [
                pc.call_function("struct_field", [cells], pc.StructFieldOptions("path"))
                for cells in pair
            ]
        if not pair[0].equals(pair[1]):
            row = next(i for i, (one, other) in enumerate(zip(*pair, strict=True)) if one != other)
            yield f", row {row}: {name} is {short(pair[0][row])}, not {short(pair[1][row])}"


def _object(found: Any, wanted: Any) -> Iterator[str]:
    """Yield what the object of a JSON file says otherwise, at any depth."""
    if not (isinstance(found, dict) and isinstance(wanted, dict)):
        if not alike(found, wanted):
            yield f" is {short(found)}; the episodes give {short(wanted)}"
        return
    for key in (*wanted, *(key for key in found if key not in wanted)):
        if key not in found or key not in wanted:
            yield f" {'lacks' if key not in found else 'has an unknown'} {key!r}"
        else:
            yield from (f": {key}{problem}" for problem in _object(found[key], wanted[key]))


def alike(found: Any, wanted: Any, tolerance: float = 0.0) -> bool:
    """Tell whether two values are the same, fractions up to ``EXACT`` and ``tolerance``."""
    if found == wanted and type(found) is type(wanted):
        return True
    try:
        one, other = np.asarray(found), np.asarray(wanted)
        return (
            one.shape == other.shape
            and np.allclose(one, other, EXACT, EXACT + tolerance, equal_nan=True)
            and (other.dtype.kind == "f")
        )
    except (TypeError, ValueError):
        return False


def short(value: object) -> str:
    """Return a value as text that fits into a sentence."""
    text = " ".join(str(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
