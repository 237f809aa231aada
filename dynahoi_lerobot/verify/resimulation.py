"""Stratified replay: stored actions, simulated again, give the stored states and pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynahoi_lerobot.rollout.replay import Resimulate
from dynahoi_lerobot.verify.checks.base import Evidence, Finding, stratified

SAME_STATE = 1e-5
"""States may differ by so much [m, rad] between processors; on one machine they are equal."""

SAME_LEVELS = 8.0
"""Pictures may differ by so many of 255 levels on average: video is lossy."""


def replay(evidence: Evidence, resimulate: Resimulate, count: int) -> Iterator[Finding]:
    """Simulate ``count`` episodes again, taking turns among the kinds of motion, and yield what differs.

    Args:
        evidence: the dataset.
        resimulate: the simulator.
        count: how many episodes.
    """
    for index in stratified(evidence.rows, count):
        episode = evidence.episode(index)
        states, pictures = resimulate(episode.meta, episode.action)
        if states.shape != episode.state.shape:
            message = f"episode {index} replays to states of shape {states.shape}; stored are {episode.state.shape}"
            yield Finding("replay", message)
            continue
        apart = np.abs(states - episode.state).max(axis=1)  # (T,)
        if (worst := float(apart.max())) > SAME_STATE:
            frame = int(np.argmax(apart > SAME_STATE))
            message = f"episode {index} replays to other states from frame {frame} on, up to {worst:.2g} m or rad apart"
            yield Finding("replay", message)
        for view in pictures.keys() & episode.images.keys():
            levels = np.abs(pictures[view].astype(int) - episode.images[view]).mean(axis=(1, 2, 3))  # (T,)
            if (worst := float(levels.max())) > SAME_LEVELS:
                what = f"another picture of {view} at frame {int(levels.argmax())}, {worst:.0f} levels apart"
                yield Finding("replay", f"episode {index} replays to {what}")
