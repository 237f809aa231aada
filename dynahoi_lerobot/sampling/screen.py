"""The screen of protocol ``occluded``: an upright panel behind which the target vanishes before a hand can meet it.

The panel stands across the view, between the hand's camera and the target. It is as large as it must be to hide the
target from home and from the straight way of a hand that meets it as early as it can. It is only drawn; hand and target
keep clear of it nevertheless.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dynahoi_lerobot.appearance import Solid, hsv
from dynahoi_lerobot.control_class import CONTROL_CLASSES, DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.sampling.occlusion import Sight, silhouette
from dynahoi_lerobot.sampling.screen_clearance import FIXTURE_CLEARANCE_M, TARGET_CLEARANCE_M, stands_clear

HIDDEN_FRAMES = (8, 7, 6)
"""Frames for which a panel is made, in the order tried; as the target goes in and comes out, some may add to them."""
MAX_HIDDEN_FRAMES = 12
"""The target is hidden no longer than this, 0.6 s, before it can be met."""
RETURN_FRAMES = (0, 1, 2, 3)
"""How many frames before the meeting the target may come out again, in the order tried."""
MIN_SEEN_FRAMES, MIN_SEEN_BEFORE_FRAMES = 4, 3
"""Least frames of the window in which a moving target is not hidden, and least of all frames before it vanishes."""
HAND_SPEED_M_S = CONTROL_CLASSES[DEFAULT_CONTROL_CLASS].palm_speed_m_s
"""Speed of the hand that meets the target as early as it can [m/s]."""
FEWEST_APPROACH_FRAMES = 2
HALF_THICKNESS_M = 0.006
LARGEST_M = 0.8
"""Greatest side of a panel."""
DEPTHS = (0.5, 0.75, 0.25, 1.0, 0.0)
"""Where it stands between camera and target, as shares of the room there is, in the order tried."""
CAMERA_ROOM_M = 0.04
"""Least distance of the panel's plane from the camera while it hides the target."""
SPARE_M = 0.003
"""The panel hides a sphere that is larger by this than the one around the target."""
SEED_PREFIX = 0x5C4EE7
"""Keeps the colour's random numbers apart from those that episodes are sampled from."""


def with_screen(spec: EpisodeSpec) -> EpisodeSpec | None:
    """Return the episode with a screen, or None if none can be placed; the screen draws from numbers of its own."""
    panel = place_panel(spec)
    if panel is None:
        return None
    rng = np.random.default_rng([SEED_PREFIX, spec.seed])
    color = hsv(rng.random(), rng.uniform(0.0, 0.6), rng.uniform(0.3, 0.9))
    return replace(spec, appearance=replace(spec.appearance, screen=Solid("box", panel.half_size, panel.pos, color)))


def place_panel(spec: EpisodeSpec) -> Box | None:
    """Return the first panel that hides the target as it should and stands in nobody's way, or None."""
    meeting = earliest_meeting(spec)
    sight = Sight.until(spec, meeting)
    for back, length in itertools.product(RETURN_FRAMES, HIDDEN_FRAMES):
        behind = np.arange(meeting - back - length, meeting - back)
        if min(behind[0], spec.window_frames) - sight.release_frame < MIN_SEEN_BEFORE_FRAMES:
            continue
        for panel in _panels(sight, behind):
            if _vanishes(sight, panel, behind) and stands_clear(panel, spec, meeting, sight.radius_m):
                return panel
    return None


def earliest_meeting(spec: EpisodeSpec) -> int:
    """Return the first frame at which a hand of ``HAND_SPEED_M_S`` that starts with the control phase is there."""
    frames = np.arange(spec.horizon_frames) - spec.window_frames
    distance = np.linalg.norm(spec.oracle_path - spec.home_pos_w, axis=1)
    reached = (frames >= FEWEST_APPROACH_FRAMES) & (distance <= HAND_SPEED_M_S * CONTROL_DT * frames)
    return int(reached.argmax())  # there is one: a hand of 0.3 m/s reaches the intercept


def _panels(sight: Sight, behind: np.ndarray) -> Iterator[Box]:
    """Yield panels behind which the target is at the frames ``behind`` (n,), as small as each depth allows."""
    eyes, target = sight.eyes_w[:, behind], sight.target_w[behind]
    nearest = eyes[..., 0].max() + CAMERA_ROOM_M
    farthest = target[:, 0].min() - sight.radius_m - TARGET_CLEARANCE_M
    if nearest > farthest:
        return
    for share in DEPTHS:
        x = nearest + share * (farthest - nearest)
        low, high = silhouette(eyes, target, x, sight.radius_m + SPARE_M)
        low, high = low.min(axis=(0, 1)), high.max(axis=(0, 1))
        if (high - low).max() <= LARGEST_M and low[1] > FIXTURE_CLEARANCE_M:
            (y, z), (half_y, half_z) = (low + high) / 2, (high - low) / 2
            yield Box((float(x), float(y), float(z)), (HALF_THICKNESS_M, float(half_y), float(half_z)))


def _vanishes(sight: Sight, panel: Box, behind: np.ndarray) -> bool:
    """Tell whether both eyes lose the target at the frames ``behind``, never for too long, and saw it before."""
    lost = sight.lost(panel)
    seen = (~lost[:, sight.release_frame : sight.window_frames]).sum(axis=1)
    return bool(
        sight.hidden(panel)[:, behind].all()
        and max(map(_longest_run, lost)) <= MAX_HIDDEN_FRAMES
        and (seen >= MIN_SEEN_FRAMES).all()
    )


def _longest_run(flags: np.ndarray) -> int:
    """Return for how many consecutive frames ``flags`` (M,) hold at most."""
    return max((sum(1 for _ in run) for held, run in itertools.groupby(flags) if held), default=0)
