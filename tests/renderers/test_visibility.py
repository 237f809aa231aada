"""The hand sees what it should watch."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import world

EVERY = 2
"""Frames from one that is rendered to the next."""


def watched(batch: WorldBatch, specs: list[EpisodeSpec]) -> list[np.ndarray]:
    """Play the windows of at most ``batch.size`` episodes; whether each rendered frame shows a pixel of the target."""
    ids = np.arange(len(specs))
    batch.reset(ids, specs)
    seen: list[list[bool]] = [[] for _ in specs]
    for frame in range(max(spec.window_frames for spec in specs)):
        if frame % EVERY == 0:
            shown = np.isin(batch.cameras.segmentation(), batch.scene.target_geoms).any(axis=(1, 2))
            for i, spec in enumerate(specs):
                if frame < spec.window_frames:
                    seen[i].append(bool(shown[i]))
        batch.step(batch.executed[ids], ids)
    return [np.array(frames) for frames in seen]


def test_at_least_95_percent_of_episodes_see_their_target_in_80_percent_of_the_window(specs: list[EpisodeSpec]):
    batch = world(specs[:22], image_size=64)
    seen = watched(batch, specs[:22]) + watched(batch, specs[22:])
    assert np.mean([frames.mean() >= 0.8 for frames in seen]) >= 0.95
