"""Replay check: simulate stored actions again and compare states and pictures with the stored ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynahoi_lerobot.verify.checks.base import CheckedDataset, Finding, stratified

if TYPE_CHECKING:
    from dynahoi_lerobot.rollout.replay import Resimulate

STATE_TOLERANCE = 1e-5
"""Greatest difference of a state [m or rad], for replays on another processor; on one machine they are equal."""

PICTURE_TOLERANCE = 8.0
"""Greatest mean difference of a picture [levels of 255]: video is lossy."""


def compare_replays(dataset: CheckedDataset, resimulate: Resimulate, count: int) -> Iterator[Finding]:
    """Simulate ``count`` episodes again, stratified by kind of motion, and yield what differs.

    Args:
        dataset: the dataset under test.
        resimulate: plays (T, 18) actions in the world of an episode.
        count: how many episodes.
    """
    for index in stratified(dataset.rows, count):
        episode = dataset.episode(index)
        states, pictures = resimulate(episode.meta, episode.action)
        if states.shape != episode.state.shape:
            message = f"episode {index} replays to states of shape {states.shape}; stored are {episode.state.shape}"
            yield Finding("replay", message)
            continue
        apart = np.abs(states - episode.state).max(axis=1)  # (T,)
        if (worst := float(apart.max())) > STATE_TOLERANCE:
            frame = int(np.argmax(apart > STATE_TOLERANCE))
            message = f"episode {index} replays to other states from frame {frame} on, up to {worst:.2g} m or rad apart"
            yield Finding("replay", message)
        for view in pictures.keys() & episode.images.keys():
            levels = np.abs(pictures[view].astype(int) - episode.images[view]).mean(axis=(1, 2, 3))  # (T,)
            if (worst := float(levels.max())) > PICTURE_TOLERANCE:
                what = f"another picture of {view} at frame {int(levels.argmax())}, {worst:.0f} levels apart"
                yield Finding("replay", f"episode {index} replays to {what}")
