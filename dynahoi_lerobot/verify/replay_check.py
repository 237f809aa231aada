"""Replay check: make episodes again from recipe and seed, and compare every column and picture with the stored ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.features import IMAGE_PREFIX, episode_features
from dynahoi_lerobot.dataset.episode_arrays import content_arrays
from dynahoi_lerobot.dataset.episode_table import EpisodeRow, row_histogram
from dynahoi_lerobot.dataset.statistics import picture_histogram, sampled_frames
from dynahoi_lerobot.sampling.fingerprint import code_fingerprint
from dynahoi_lerobot.verify.checks.base import CheckedDataset, Finding, stratified

if TYPE_CHECKING:
    from dynahoi_lerobot.rollout.replay import Resimulate

TOLERANCE = 1e-5
"""Greatest difference of a number [its unit], for replays on another processor; on one machine they are equal."""

PICTURE_TOLERANCE = 12.0
"""Greatest mean difference of a picture [levels of 255]: video is lossy (seen: 6.4 at 32 px, 8.3 at 16 px)."""
NEARER_SHARE = 0.85
"""A stored picture shows another frame if its mean difference from that frame's rendering is at most this share of that
from its own (seen in sound videos: 0.99 at 32 px, 0.92 at 16 px)."""
WAY_SHARE, WAY_RATIO = 0.7, 3.0
"""So it does if it lies beyond this share of the way from its own rendering to that frame's, and if those two are
further apart, in sums of squares, than this many times its own distance from the latter: what changes in a few pixels
shows here. Sound videos have one or the other; where renderings hardly differ, an encoder may keep what it has."""
COMPARED_PX = 32
"""Pictures are thinned to about this side before their mean differences from all frames are taken."""
HISTOGRAM_TOLERANCE = 0.001
"""Share of pixels whose level another renderer may change in the stored histogram."""


def compare_replays(dataset: CheckedDataset, count: int, resimulate: Resimulate | None = None) -> Iterator[Finding]:
    """Make ``count`` episodes again, stratified by kind of motion, and yield what differs.

    Args:
        dataset: the dataset under test.
        count: how many episodes.
        resimulate: makes the episode of a seed; by default the expert of the manifest's recipe.
    """
    if (refusal := _refusal(dataset)) is not None:
        yield Finding("replay", refusal)
        return
    resimulate = resimulate or _simulator(dataset)
    for index in stratified(dataset.rows, count):
        stored = dataset.episode(index)
        made = resimulate(stored.meta.seed)
        if made is None:
            yield Finding("replay", f"episode {index}: the expert does not manage seed {stored.meta.seed}")
            continue
        problems = [*_values(made, stored), *_arrays(made, stored), *_pictures(made, stored)]
        problems += _histograms(made, dataset.stats_rows[index])
        yield from (Finding("replay", f"episode {index} replays to {problem}") for problem in problems)


def _refusal(dataset: CheckedDataset) -> str | None:
    """Return why no episode can be made again, None if nothing is in the way."""
    if dataset.recipe is None:
        return "the manifest names no recipe that can be read, so no episode can be made again"
    made_with, here = dataset.manifest.provenance.get("code"), code_fingerprint()
    if made_with == here:
        return None
    return f"the dataset was made by other code ({made_with}, here is {here}); only the same code makes it again"


def _simulator(dataset: CheckedDataset) -> Resimulate:
    from dynahoi_lerobot.rollout.replay import on_policy_simulator, simulator  # compile the scene

    if (recipe := dataset.recipe) is None or not recipe.on_policy:
        return simulator(dataset.manifest.provenance["recipe"])
    place = {row["seed"]: index for index, row in enumerate(dataset.rows)}
    return on_policy_simulator(recipe, lambda seed: dataset.episode(place[seed], images=False))


def _values(made: Episode, stored: Episode) -> Iterator[str]:
    """Yield facts about the episode that differ, strings and whole numbers exactly."""
    one = asdict(made.meta) | {"success": made.success, "stage": made.stage}
    other = asdict(stored.meta) | {"success": stored.success, "stage": stored.stage}
    yield from (f"{name} {one[name]!r}; stored is {other[name]!r}" for name in one if one[name] != other[name])


def _arrays(made: Episode, stored: Episode) -> Iterator[str]:
    """Yield columns that differ by more than the tolerance, with the first frame that does."""
    ones, others = _columns(made), _columns(stored)
    for key in sorted(ones.keys() | others.keys()):
        one, other = ones.get(key), others.get(key)
        if one is None or other is None or one.shape != other.shape:
            found, held = (None if x is None else x.shape for x in (one, other))
            yield f"{key} of shape {found}; stored is {held}"
            continue
        apart = np.abs(one.astype(float) - other).reshape(len(one), -1).max(axis=1)  # (T,)
        if not (worst := float(apart.max())) <= TOLERANCE:
            yield f"another {key} from frame {int((~(apart <= TOLERANCE)).argmax())} on, up to {worst:.2g} apart"


def _columns(episode: Episode) -> dict[str, np.ndarray]:
    tables = {feature.key: np.atleast_1d(getattr(episode, feature.name)) for feature in episode_features()}
    return content_arrays(episode) | tables


def _pictures(made: Episode, stored: Episode) -> Iterator[str]:
    for view in sorted(made.images.keys() | stored.images.keys()):
        one, other = made.images.get(view), stored.images.get(view)
        if one is None or other is None or one.shape != other.shape:
            found, held = (None if x is None else x.shape for x in (one, other))
            yield f"pictures of {view} of shape {found}; stored is {held}"
            continue
        yield from (f"another picture of {view} {problem}" for problem in _frames(one, other))


def _frames(made: np.ndarray, stored: np.ndarray) -> Iterator[str]:
    """Yield the first stored picture that is not its frame's, (T, H, W, 3) each."""
    levels, way = _mean_levels(made, stored), _way_to_others(_flat(made), _flat(stored))
    own = levels.diagonal()
    nearer = levels.min(axis=1) < NEARER_SHARE * own
    swapped = nearer | (way.max(axis=1) > WAY_SHARE)
    wrong = swapped | (own > PICTURE_TOLERANCE)
    if not wrong.any():
        return
    frame = int(wrong.argmax())
    looks_like = levels[frame].argmin() if nearer[frame] else way[frame].argmax()
    shows = f", it looks like frame {int(looks_like)}" if swapped[frame] else ""
    yield f"at frame {frame}, {own[frame]:.1f} levels apart{shows}"


def _mean_levels(made: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """Return (T stored, T made) mean differences [levels of 255] of thinned pictures."""
    step = max(1, made.shape[1] // COMPARED_PX)
    made, stored = (pictures[:, ::step, ::step].astype(np.int16) for pictures in (made, stored))
    return np.stack([np.abs(made - picture).mean(axis=(1, 2, 3)) for picture in stored])


def _flat(pictures: np.ndarray) -> np.ndarray:
    return pictures.reshape(len(pictures), -1).astype(np.float32)


def _way_to_others(made: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """Return where each stored picture lies between its own rendering and those of all frames.

    Args:
        made, stored: (T, P) levels.

    Returns:
        (T, T): (s_t - m_t) . (m_u - m_t) / |m_u - m_t|^2 for stored pictures s and renderings m: 0 for a picture that
        is its frame's, 1 for that of frame u; 0 where coding may explain the difference between the two.
    """
    products = made @ made.T  # (T, T)
    size = products.diagonal()
    apart = size[:, None] + size - 2 * products
    moved = stored - made
    towards = moved @ made.T - (moved * made).sum(axis=1)[:, None]
    left = (moved**2).sum(axis=1)[:, None] - 2 * towards + apart  # |s_t - m_u|^2
    return np.divide(towards, apart, out=np.zeros_like(apart), where=apart > WAY_RATIO * left)


def _histograms(made: Episode, row: EpisodeRow) -> Iterator[str]:
    """Yield views whose stored histogram, taken before the video was encoded, is not that of the rendering."""
    for view, images in made.images.items():
        stored = row_histogram(row, IMAGE_PREFIX + view)
        found = picture_histogram(images[sampled_frames(len(images))])
        if np.abs(found - stored).sum() > 2 * HISTOGRAM_TOLERANCE * found.sum():
            yield f"another histogram of {view} than the episode table holds"
