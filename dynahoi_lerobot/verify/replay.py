"""Third claim: episodes follow from their seeds. They are made again, and every column and image is compared."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES, IMAGE_PREFIX
from dynahoi_lerobot.dataset.episode_table import EpisodeRow
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store
from dynahoi_lerobot.dataset.video import Encoding, VideoFile, decode, encode, encoded_stream, stored_packets
from dynahoi_lerobot.rollout.loop import played_again
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.recipe import Recipe

TOLERANCE = 1e-5
"""Greatest difference of a number [its unit], for replays on another processor; on one machine they are equal."""
BLOCK_PX = 2
BLOCK_LEVELS = 32.0
"""Greatest difference of two images' means over a block of 2 x 2 px [levels of 255] where another renderer, such as a
GPU's, made them."""


def replay_problems(
    store: Store, indices: list[int], recipe: Recipe | None, note: Callable[[str], object]
) -> Iterator[str]:
    """Make episodes again by the manifest's recipe, None if it cannot be read, and yield what differs.

    ``note`` is told in a sentence what was found equal.
    """
    made_with, here = Manifest.read(store.root).provenance.get("code"), code_fingerprint()
    if recipe is None or made_with != here:
        yield f"the dataset was made by other code ({made_with}, here is {here}); only the same code makes it again"
        return
    images: list[tuple[str, float]] = []  # views of episodes, and how far apart they are
    for index in indices:
        table = store.frames(row := store.row(index))
        stored = store.as_episode(row, table, images=False)
        if (made := played_again(recipe, stored)) is None:
            yield f"episode {index}: the expert does not manage seed {row['seed']}"
            continue
        problems = [*_facts(made, stored), *_arrays(made, stored)]
        yield from (f"episode {index} replays to {problem}" for problem in problems)
        for key in store.image_keys:
            view = made.images.get(key.removeprefix(IMAGE_PREFIX))
            if view is None or view.shape[:2] != (row["length"], store.features[key]["shape"][0]):
                yield f"episode {index} replays to other images of {key}: {None if view is None else view.shape}"
            else:
                images.append((f"{key} of episode {index}", _apart(view, store, row, table, key)))
    equal = sum(apart == 0.0 for _, apart in images)
    allowed = 0.0 if equal else BLOCK_LEVELS  # where some are equal, codec and renderer are the same
    for name, apart in images:
        if apart > allowed:
            yield f"{name} shows other images than are made again, up to {apart:.1f} levels of 255 over {BLOCK_PX} px"
    note(f"replayed {len(indices)} episodes; of {len(images)} videos of them {equal} are equal byte for byte")


def _facts(made: Episode, stored: Episode) -> Iterator[str]:
    """Yield facts about the episode that differ, strings and whole numbers exactly."""
    one = asdict(made.meta) | {"success": made.success, "stage": made.stage}
    other = asdict(stored.meta) | {"success": stored.success, "stage": stored.stage}
    yield from (f"{name} {one[name]!r}; stored is {other[name]!r}" for name in one if one[name] != other[name])


def _arrays(made: Episode, stored: Episode) -> Iterator[str]:
    """Yield columns that differ by more than the tolerance."""
    for name in FEATURES:
        one, other = getattr(made, name), getattr(stored, name)
        if one is None or other is None:
            if one is not other:
                yield f"{'no' if one is None else 'a'} column {name}"
            continue
        if np.shape(one) != np.shape(other):
            yield f"{name} of shape {np.shape(one)}; stored is {np.shape(other)}"
            continue
        apart = np.abs(np.asarray(one, float) - other)
        if not (worst := float(apart.max(initial=0.0))) <= TOLERANCE:
            frames = apart.reshape(len(apart), -1).max(axis=1) if apart.ndim else apart.reshape(1)
            first = int((~(frames <= TOLERANCE)).argmax())
            yield f"another {name} from row {first} on, up to {worst:.2g} apart"


def _apart(made: np.ndarray, store: Store, row: EpisodeRow, table: pa.Table, key: str) -> float:
    """Return how far an episode's stored images of a view are from those made again, (T, H, W, 3) uint8.

    Returns:
        0 if they are stored in the same bytes, else the greatest difference of two blocks' means [levels of 255].
    """
    if not store.has_video:
        stored = store.images(row, table, key)
        return 0.0 if np.array_equal(made, stored) else _greatest_block(made, stored)
    info, start = store.features[key]["info"], round(row[f"videos/{key}/from_timestamp"] * CONTROL_HZ)
    encoding = Encoding("h264", info["video.crf"], info["video.preset"], info["video.g"])
    with TemporaryDirectory() as folder:
        again = Path(folder) / "again.mp4"
        video = VideoFile(again, partial(encoded_stream, encoding=encoding, image_size=made.shape[1]))
        video.append(encode(made, encoding))
        video.close()
        stored = islice(stored_packets(store.video_path(row, key)), start, start + row["length"])
        if [bytes(packet) for packet in stored_packets(again)] == [bytes(packet) for packet in stored]:
            return 0.0
        return _greatest_block(np.stack(list(decode(again))), store.images(row, table, key))


def _greatest_block(one: np.ndarray, other: np.ndarray) -> float:
    """Return the greatest difference of two images' means over a block, wherever it lies; 255 for other shapes."""
    if one.shape != other.shape:
        return 255.0
    worst = 0.0
    for made, stored in zip(one, other, strict=True):
        apart = made.astype(np.float32) - stored  # (H, W, 3)
        rows = apart[:-1] + apart[1:]
        worst = max(worst, float(np.abs(rows[:, :-1] + rows[:, 1:]).max()) / BLOCK_PX**2)
    return max(worst, 1e-3)  # other bytes that decode to the same pixels are other bytes
