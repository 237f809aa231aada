"""Episodes written out by hand: a few frames, every number visible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.rules import one_hot_phase
from dynahoi_lerobot.rollout.recorder import next_frames
from tests.synthetic import synthetic_episode

WINDOW = 8


def hand_made(
    palm: Sequence[Sequence[float]],
    *,
    target: Sequence[Sequence[float]] | None = None,
    joints: Sequence[float] = (),
    localized_from: int | None = None,
    length_frames: int = 40,
    **changes: object,
) -> Episode:
    """Return an episode that rests for 8 frames and then passes through the ``palm`` positions [m].

    ``joints`` gives one angle [rad] per control frame, taken by all 15 joints (reference 1, open 0);
    ``localized_from`` counts from control start.
    """
    points = _after_the_window(palm)
    frames = len(points)
    angles = np.zeros((frames, 15), np.float32)
    angles[WINDOW : WINDOW + len(joints)] = np.array(joints, np.float32)[:, None]
    state = np.hstack([points, angles])
    aim = np.full((frames, 3), 10.0) if target is None else _after_the_window(target)
    localized = np.arange(frames) >= (frames if localized_from is None else WINDOW + localized_from)
    episode = synthetic_episode(frames=40, image_size=None)
    return replace(
        episode,
        meta=replace(episode.meta, window_frames=WINDOW, length_frames=length_frames),
        state=state,
        action=np.vstack([state[1:], state[-1:]]),
        executed_action=np.vstack([state[1:], state[-1:]]),
        fingertips=np.zeros((frames, 30), np.float32),
        phase=one_hot_phase(np.arange(frames) >= WINDOW),
        target_pose=np.hstack([aim, np.tile([1.0, 0, 0, 0], (frames, 1))]).astype(np.float32),
        target_velocity=np.zeros((frames, 6), np.float32),
        target_contacts=np.zeros((frames, 5), np.float32),
        palm_distance=np.linalg.norm(points - aim, axis=1).astype(np.float32),
        fingertip_distance=np.full(frames, 0.5, np.float32),
        localized=localized,
        captured=localized,
        succeeded=next_frames(localized),
        **changes,
    )


def _after_the_window(points: Sequence[Sequence[float]]) -> np.ndarray:
    return np.array([points[0]] * WINDOW + list(points), np.float32)
