"""Put stored episodes together into a new dataset, without decoding or encoding images: merge, and
copy a part.

LeRobot's ``aggregate_datasets`` needs torch, which making data does not, averages quantiles,
appends to ever longer videos, of which its reader reads the whole index for every sample, rewrites
a file for every source and drops the privileged tables. So does its ``delete_episodes``, which also
re-encodes videos and drops our columns of the episode table.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

from av.packet import Packet

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.files import new_folder
from dynahoi_lerobot.core.reading import reading, validated
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import MANIFEST_PATH, FileLimits
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import stored_packets
from dynahoi_lerobot.dataset.writer import DatasetWriter
from dynahoi_lerobot.sampling.salt import refuse_to_mix


def merge(sources: Sequence[Path], root: Path, limits: FileLimits | None = None) -> Manifest:
    """Merge datasets of this project, in the given order, into a new one; ``root`` appears when it
    is complete.

    Raises:
        FileExistsError: if ``root`` exists.
        ValueError: if the datasets' features or versions of the benchmark differ, or there are
            none.
    """
    if root.exists():
        raise FileExistsError(f"{root} exists; choose a new folder for the merged dataset")
    stores = [Store(source) for source in sources]
    if not stores:
        raise ValueError("there is nothing to merge; name one dataset or more")
    first = _columns(stores[0])
    for store in stores[1:]:
        other = _columns(store)
        keys = sorted(first.keys() | other.keys())
        differing = [key for key in keys if first.get(key) != other.get(key)]
        if differing:
            raise ValueError(
                f"{store.root} has other features than {stores[0].root} "
                f"({', '.join(differing)}); merge datasets that "
                "were generated with the same options"
            )
    manifests = [Manifest.read(store.root) for store in stores]
    benchmarks = [manifest.benchmark for manifest in manifests]
    found = zip(sources, benchmarks, strict=True)
    refuse_to_mix("benchmark", found, "merge datasets of one version")
    yields: Counter[str] = Counter()
    for manifest in manifests:
        yields.update(manifest.yields)
    return _assemble(root, ((store, None) for store in stores), limits, {}, yields)


def merge_in_turn(
    sources: Iterable[Path], root: Path, *, limits: FileLimits, provenance: dict[str, Any]
) -> Manifest:
    """Merge datasets of one plan as ``merge`` does, but each is opened when it is its turn, so that
    those after it may still be in the making.
    """
    yields: Counter[str] = Counter()

    def stores() -> Iterator[tuple[Store, None]]:
        for source in sources:
            yields.update(Manifest.read(source).yields)
            yield Store(source), None

    return _assemble(root, stores(), limits, provenance, yields)


def copy_subset(root: Path, output: Path, episodes: Collection[int]) -> Manifest:
    """Copy the episodes of some indices, in their order, to a new dataset; ``output`` appears when
    it is complete.

    Raises:
        FileExistsError: if ``output`` exists.
        FileNotFoundError: if ``root`` holds no dataset.
        ValueError: if no episode is kept, one does not exist, or another tool has written the
            dataset.
    """
    store = Store(root)
    kept = set(episodes)
    if output.exists():
        raise FileExistsError(f"{output} exists; choose a new folder")
    manifest = Manifest.read(root)
    if not kept:
        raise ValueError("got no episodes to keep; a dataset needs at least one")
    unknown = sorted(kept - set(range(store.episodes)))
    if unknown:
        raise ValueError(f"episode {unknown[0]} does not exist; {root} holds {store.episodes}")
    with reading(root / MANIFEST_PATH):
        limits = validated(FileLimits, manifest.provenance.get("limits", {}), "limits")
        # numbers in the plan, from which an earlier copy may have left some out
        earlier = manifest.provenance.get("kept", list(range(store.episodes)))
        numbers = validated(list[int], earlier, "kept")
    provenance = manifest.provenance | {
        "kept": [number for index, number in enumerate(numbers) if index in kept]
    }
    return _assemble(output, iter([(store, kept)]), limits, provenance, {})


def _assemble(
    root: Path,
    sources: Iterator[tuple[Store, Collection[int] | None]],
    limits: FileLimits | None,
    provenance: dict[str, Any],
    yields: Mapping[str, int],
) -> Manifest:
    """Write a dataset of stored episodes: of each source those with the given indices, None for
    all. ``yields`` are read at the end.
    """
    first, kept_of_first = next(sources)
    with new_folder(root) as folder:
        with reading(first.root, OSError):  # an OSError is of the folder that is written
            columns = first.privileged.features
            options = {"limits": limits, "features": first.features}
            made = DatasetWriter(folder, columns, **options)
        with made as writer:
            for store, kept in chain([(first, kept_of_first)], sources):
                # each view's file that was read last stays in memory
                packets_of = lru_cache(len(store.video_keys))(lambda path: [*stored_packets(path)])
                with reading(store.root, OSError):
                    for index, stored in enumerate(store.stored_episodes()):
                        if kept is None or index in kept:
                            writer.copy(
                                store, stored, _episode_packets(store, stored.row, packets_of)
                            )
            with reading(first.root, OSError):
                return writer.finish(provenance, dict(yields))


def _episode_packets(
    store: Store, row: EpisodeRow, packets_of: Callable[[Path], list[Packet]]
) -> dict[str, list[Packet]]:
    """Return the packets of each view of an episode; none without video.

    Raises:
        ValueError: if a file is shorter than the row says.
    """
    found = {}
    for key in store.video_keys:
        path = store.video_path(row, key)
        start = round(row[f"videos/{key}/from_timestamp"] * CONTROL_HZ)
        stop = start + row["length"]
        found[key] = packets_of(path)[start:stop]
        if len(found[key]) < row["length"]:
            raise ValueError(f"{path} ends before frame {stop}")
    return found


def _columns(store: Store) -> dict[str, Any]:
    """Return the features of the columns of all tables, by key."""
    return store.features | {feature.key: feature for feature in store.privileged.features}
