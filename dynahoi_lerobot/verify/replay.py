"""The claim of a replay: episodes follow from their seeds.

What an episode is follows without playing it; played again, it has the same columns and images.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import batched, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_HZ
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import FEATURES, IMAGE_PREFIX
from dynahoi_lerobot.core.numerics import TOLERANCE
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store, StoredEpisode
from dynahoi_lerobot.dataset.video import VideoFile, decode, encode, stored_packets
from dynahoi_lerobot.rollout.loop import played_again
from dynahoi_lerobot.rollout.recorder import Job, episode_constants, episode_meta
from dynahoi_lerobot.rollout.recording import Recording
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.sampling.splits import REDRAW_STRIDE
from dynahoi_lerobot.world.batch import WorldBatch

AT_ONCE = 64
PLAYED = ("first_plan",)
"""Constants of an episode that depend on who plays it."""
MEAN_LEVELS = 2.0
"""Greatest mean difference of an image [levels of 255]."""
BLOCK_LEVELS = {12: 16.0, 2: 64.0}
"""Greatest mean difference of a square of so many pixels, wherever it lies [levels of 255]."""


def seed_problems(
    store: Store,
    manifest: Manifest,
    recording: Recording,
    note: Callable[[str], object],
) -> Iterator[str]:
    """Yield seeds that are not the plan's, and facts and constants of episodes that their seeds do
    not give.

    ``note`` is told in a sentence why that could not be checked, if so.
    """
    plan = manifest.provenance
    seeds = [row["seed"] for row in store.rows]
    kept = plan.get("kept", range(plan["episodes"]))
    if sorted(seed % REDRAW_STRIDE for seed in seeds) != [plan["seed"] + slot for slot in kept]:
        yield f"the seeds are not those of {len(kept)} episodes from seed {plan['seed']} on"
    recipe = recording.recipe
    if recipe.salt:
        return note(
            "its episodes are hidden behind a salt, so nothing else was compared with the seeds, "
            "or played again"
        )
    if plan["code"] != code_fingerprint():
        return note(
            f"made by other code ({plan['code']}), so nothing else was compared with the seeds"
        )
    batch = WorldBatch(recipe.rules, 1)
    episodes = store.stored_episodes()
    for some in batched(seeds, AT_ONCE):
        for spec in sample_specs(recipe, some, threads=0):
            rows = next(episodes)
            stored = store.as_episode(rows, images=False)
            job = Job(0, spec, 0, stored.meta.attempts)
            meta = episode_meta(job, recipe.rules, recording.actor or recording.expert_name)
            constants = episode_constants(batch, spec, None)
            wanted = {name: value for name, value in constants.items() if name not in PLAYED}
            problems = differences(vars(meta) | wanted, vars(stored.meta) | vars(stored))
            index = rows.row["episode_index"]
            yield from (f"episode {index} has by its seed {problem}" for problem in problems)


def differences(made: Mapping[str, Any], stored: Mapping[str, Any]) -> Iterator[str]:
    """Yield what was made otherwise than it is stored: text and whole numbers exactly, others up to
    ``TOLERANCE``.
    """
    for name, one in made.items():
        other = stored[name]
        if one is None or other is None or isinstance(one, str | int):
            if type(one) is not type(other) or one != other:
                yield f"{name} {one!r:.80}; stored is {other!r:.80}"
            continue
        values = np.asarray(one, FEATURES[name].dtype)
        if values.shape != np.shape(other):
            yield f"{name} of shape {values.shape}; stored is {np.shape(other)}"
            continue
        apart = np.abs(np.atleast_1d(values).astype(float) - other)
        for first, *_ in np.argwhere(~(apart <= TOLERANCE))[:1]:
            yield f"another {name} from row {first} on, up to {apart.max():.2g} apart"


def replay_problems(
    store: Store,
    indices: list[int],
    recording: Recording,
    note: Callable[[str], object],
) -> Iterator[str]:
    """Play episodes again by the manifest's recording and yield what differs.

    ``note`` is told in a sentence what was found equal, and that other code made the dataset.
    """
    made_with = Manifest.read(store.root).provenance.get("code")
    here = code_fingerprint()
    if made_with != here:
        note(f"made by other code ({made_with}, here is {here}), so that it may play differently")
    videos = 0
    equal = 0
    for index in indices:
        rows = store.stored(index)
        row = rows.row
        stored = store.as_episode(rows, images=False)
        made = played_again(recording, stored)
        if made is None:
            yield f"episode {index}: the expert does not manage seed {row['seed']}"
            continue
        problems = differences(_content(made) | {"code": made_with}, _content(stored))
        yield from (f"episode {index} replays to {problem}" for problem in problems)
        for key in store.image_keys:
            view = made.images.get(key.removeprefix(IMAGE_PREFIX))
            if view is None or view.shape[:2] != (row["length"], store.features[key]["shape"][0]):
                yield (
                    f"episode {index} replays to other images of {key}: "
                    f"{None if view is None else view.shape}"
                )
                continue
            again, stored_images, same = _both(view, store, rows, key)
            videos += 1
            equal += same
            problem = None if same else _apart(again, stored_images)
            if problem:
                yield f"{key} of episode {index} {problem}"
    if videos:
        kind = "videos" if store.video_keys else "sequences of images"
        note(f"{equal} of the {videos} {kind} replayed are equal byte for byte")


def _content(episode: Episode) -> dict[str, object]:
    """Return everything but images by name."""
    outcome = {"success": episode.success, "stage": episode.stage}
    return vars(episode.meta) | outcome | {name: getattr(episode, name) for name in FEATURES}


def _both(
    made: np.ndarray, store: Store, rows: StoredEpisode, key: str
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return an episode's images of a view, (T, H, W, 3) uint8, as they are made again and as they
    are stored.

    What is made again is encoded with the codec's recorded settings and decoded, too. The third
    value tells whether both are stored in the same bytes.
    """
    row = rows.row
    stored = store.images(row, rows.frames, key)
    if key not in store.video_keys:
        return made, stored, np.array_equal(made, stored)
    encoding = store.encoding
    start = round(row[f"videos/{key}/from_timestamp"] * CONTROL_HZ)
    with TemporaryDirectory() as folder:
        again = Path(folder) / "again.mp4"
        video = VideoFile(again, encoding, made.shape[1])
        video.append(encode(made, encoding))
        video.close()
        packets = islice(stored_packets(store.video_path(row, key)), start, start + row["length"])
        same = [bytes(packet) for packet in stored_packets(again)] == [
            bytes(packet) for packet in packets
        ]
        return np.stack(list(decode(again))), stored, same


def _apart(made: np.ndarray, stored: np.ndarray) -> str | None:
    """Say where images differ by more than another processor's or renderer's rounding."""
    if made.shape != stored.shape:
        return f"shows images of shape {stored.shape}; {made.shape} is made again"
    for frame, (one, other) in enumerate(zip(made, stored, strict=True)):
        apart = cv2.absdiff(one, other).mean(axis=2, dtype=np.float32)  # (H, W)
        found = [("all", apart.mean(), MEAN_LEVELS)]
        for n, most in BLOCK_LEVELS.items():
            found.append((f"{n} x {n}", cv2.blur(apart, (n, n)).max(), most))
        for where, levels, most in found:
            if levels > most:
                told = (
                    f"{levels:.1f} of 255 levels in the mean of {where} px of frame {frame}; "
                    f"{most:g} are allowed"
                )
                return f"shows other images than are made again: {told}"
    return None
