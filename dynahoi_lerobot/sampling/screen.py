"""The screen of protocol ``occluded``: an upright panel behind which the target vanishes before a hand can meet it.

The panel stands across the view, between the hand's camera and the target. It is as large as the camera needs it to be,
both from home and on the straight way of a hand that meets the target as early as it can. It only takes part in
pictures; hand and target keep clear of it nevertheless.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dynahoi_lerobot.appearance import Solid, hsv
from dynahoi_lerobot.control_class import CONTROL_CLASSES, DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.foundation.rotations import quat_to_matrix
from dynahoi_lerobot.hands.gantry import CAMERA_POS
from dynahoi_lerobot.motions import PhysicalMotion
from dynahoi_lerobot.motions.launch import Box, Launch
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.sampling.fixture_clearance import _hand_points, box_distance, keeps_clear

MIN_HIDDEN_FRAMES, MAX_HIDDEN_FRAMES = 6, 12
"""The target vanishes for so long, 0.3 to 0.6 s, and is hidden no longer at any other time before it can be met."""
HIDDEN_FRAMES = (8, 7, 6)
"""Frames for which a panel is made, those tried first first; the target's extent adds to them."""
LATEST_RETURN_FRAMES = (0, 1, 2, 3)
"""How many frames before the meeting the target may come out again; those tried first first."""
MIN_SEEN_FRAMES = 4
"""Least frames of the observation window in which a moving target is not hidden."""
MIN_SEEN_BEFORE_FRAMES = 3
"""Of these, least frames before it vanishes."""
HAND_SPEED_M_S = CONTROL_CLASSES[DEFAULT_CONTROL_CLASS].palm_speed_m_s
"""Speed of the hand that meets the target as early as it can [m/s]: that of all classes with a limit."""
FEWEST_APPROACH_FRAMES = 2

HALF_THICKNESS_M = 0.006
LARGEST_M = 0.8
"""Greatest side of a panel."""
DEPTHS = (0.5, 0.75, 0.25, 1.0, 0.0)
"""Where the panel stands between the camera and the target, as shares of the room there is; those tried first first."""
CAMERA_ROOM_M, TARGET_ROOM_M, FIXTURE_ROOM_M = 0.04, 0.01, 0.01
"""Least distances of the panel from the camera's plane, the target's surface and fixtures."""
SPARE_M = 0.003
"""The panel hides a sphere that is larger by this than the one around the target."""
INNER_SHARE = 0.8
"""A sphere of so much of the grasp radius is taken to be part of the target, however it is turned."""
SLIVER_M = 0.006
"""What shows of it beside the panel is narrower than this on the panel's plane does not count: it is about a pixel."""
STEEPEST_RAD = 1.5
"""Lines of sight that are more oblique to the panel do not count."""
WAY_POINTS = 24
SEED_PREFIX = 0x5C4EE7
"""Keeps the colour's random numbers apart from those that episodes are sampled from."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Who looks at what until the target can be met, at frame M.

    Attributes:
        eyes_w: (2, M, 3) the camera at every frame [m], world: of the waiting hand, and of one that goes straight to
            the meeting from control start on.
        target_w: (M, 3) the untouched target's centre [m], world.
        radius_m: of the sphere around the target.
        inner_m: of a sphere within it.
    """

    eyes_w: np.ndarray
    target_w: np.ndarray
    radius_m: float
    inner_m: float


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
    sight = _sight(spec, meeting)
    released = _release_frame(spec)
    for back, hidden in itertools.product(LATEST_RETURN_FRAMES, HIDDEN_FRAMES):
        behind = np.arange(meeting - back - hidden, meeting - back)
        if min(behind[0], spec.window_frames) - released < MIN_SEEN_BEFORE_FRAMES:
            continue
        for panel in _panels(sight, behind):
            runs_fit = all(_vanishes(sight, eye, panel, behind, released, spec.window_frames) for eye in sight.eyes_w)
            if runs_fit and _stands_clear(panel, spec, meeting, sight.radius_m):
                return panel
    return None


def earliest_meeting(spec: EpisodeSpec) -> int:
    """Return the first frame at which a hand of ``HAND_SPEED_M_S`` that starts with the control phase is there."""
    frames = np.arange(spec.horizon_frames) - spec.window_frames
    distance = np.linalg.norm(spec.oracle_path - spec.home_pos_w, axis=1)
    reached = (frames >= FEWEST_APPROACH_FRAMES) & (distance <= HAND_SPEED_M_S * CONTROL_DT * frames)
    return int(reached.argmax())  # there is one: a hand of 0.3 m/s reaches the intercept


def _sight(spec: EpisodeSpec, meeting: int) -> Sight:
    share = (np.arange(meeting) - spec.window_frames) / (meeting - spec.window_frames)
    way = np.maximum(share, 0.0)[:, None] * (spec.oracle_path[meeting] - spec.home_pos_w)
    waiting = np.tile(spec.home_pos_w + CAMERA_POS, (meeting, 1))
    return Sight(
        eyes_w=np.stack([waiting, waiting + way]),
        target_w=spec.oracle_path[:meeting],
        radius_m=enclosing_radius_m(spec.target),
        inner_m=INNER_SHARE * spec.target.grasp_radius_m,
    )


def enclosing_radius_m(target: TargetObject) -> float:
    """Return the radius [m] of a sphere around the centre that holds all of an object."""
    return max(
        float(np.linalg.norm(part.pos)) + _EXTENTS[part.shape](np.asarray(part.half_size)) for part in target.primitives
    )


_EXTENTS = {
    "sphere": lambda half: float(half[0]),
    "capsule": lambda half: float(half[0] + half[1]),
    "cylinder": lambda half: float(np.hypot(half[0], half[1])),
    "ellipsoid": lambda half: float(half.max()),
    "box": lambda half: float(np.linalg.norm(half)),
}
"""How far each shape reaches from its centre [m], from its (3,) half-sizes."""


def _panels(sight: Sight, behind: np.ndarray) -> Iterator[Box]:
    """Yield panels behind which the target is at the frames ``behind`` (n,), as small as each depth allows."""
    eyes, target = sight.eyes_w[:, behind], sight.target_w[behind]
    nearest = eyes[..., 0].max() + CAMERA_ROOM_M
    farthest = target[:, 0].min() - sight.radius_m - TARGET_ROOM_M
    if nearest > farthest:
        return
    for share in DEPTHS:
        x = nearest + share * (farthest - nearest)
        low, high = silhouette(eyes, target, x, sight.radius_m + SPARE_M)
        low, high = low.min(axis=(0, 1)), high.max(axis=(0, 1))
        if (high - low).max() <= LARGEST_M and low[1] > FIXTURE_ROOM_M:
            (y, z), (half_y, half_z) = (low + high) / 2, (high - low) / 2
            yield Box((float(x), float(y), float(z)), (HALF_THICKNESS_M, float(half_y), float(half_z)))


def silhouette(eyes_w: np.ndarray, centers_w: np.ndarray, x: float, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what of an upright plane across x lies before a sphere.

    Args:
        eyes_w: (..., 3) where it is seen from [m], world.
        centers_w: (..., 3) of the sphere [m], world.
        x: of the plane [m], world.
        radius_m: of the sphere.

    Returns:
        Lowest and highest y and z (..., 2) [m], world; infinite where the plane is not between the two.
    """
    offset = centers_w - eyes_w
    ahead, aside = offset[..., :1], offset[..., 1:]
    middle = np.arctan2(aside, ahead)
    half = np.arcsin(np.clip(radius_m / np.maximum(np.hypot(ahead, aside), radius_m), 0.0, 1.0))
    gap = x - eyes_w[..., :1]
    between = (gap > 0) & (ahead - radius_m > gap) & (np.abs(middle) + half < STEEPEST_RAD)
    low = np.where(between, eyes_w[..., 1:] + gap * np.tan(middle - half), -np.inf)
    return low, np.where(between, eyes_w[..., 1:] + gap * np.tan(middle + half), np.inf)


def hidden(
    panel: Box, eyes_w: np.ndarray, centers_w: np.ndarray, radius_m: float, sliver_m: float = 1e-9
) -> np.ndarray:
    """Tell from which eyes (..., 3) a panel hides all of a sphere around (..., 3) [m], world: (...) bool."""
    low, high = silhouette(eyes_w, centers_w, panel.pos[0], radius_m)
    middle, half = np.asarray(panel.pos[1:]), np.asarray(panel.half_size[1:]) + sliver_m
    return ((low >= middle - half) & (high <= middle + half)).all(axis=-1)


def _vanishes(
    sight: Sight, eye_w: np.ndarray, panel: Box, behind: np.ndarray, released: int, window_frames: int
) -> bool:
    """Tell whether one eye (M, 3) loses the target at ``behind`` for long enough, never for too long, and saw it first.

    All of the target is hidden if the sphere around it is; some of it shows if the sphere within it shows.
    """
    whole = hidden(panel, eye_w, sight.target_w, sight.radius_m)
    inner = hidden(panel, eye_w, sight.target_w, sight.inner_m, SLIVER_M)
    longest = max(map(len, _runs(inner)), default=0)
    seen = (~inner[released:window_frames]).sum()
    return bool(whole[behind].all() and longest <= MAX_HIDDEN_FRAMES and seen >= MIN_SEEN_FRAMES)


def _runs(flags: np.ndarray) -> list[np.ndarray]:
    """Return the indices at which ``flags`` (M,) hold, split where they are not consecutive."""
    held = np.flatnonzero(flags)
    return np.split(held, np.flatnonzero(np.diff(held) > 1) + 1)


def _stands_clear(panel: Box, spec: EpisodeSpec, meeting: int, radius_m: float) -> bool:
    """Tell whether hand, camera, target and all that belongs to the motion keep clear of the panel."""
    home, launch = spec.home_pos_w, _launch(spec)
    share = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
    if box_distance(spec.oracle_path, panel).min() < radius_m + TARGET_ROOM_M:
        return False
    for goal in (spec.oracle_path[meeting], spec.intercept_pos_w):
        eyes = home + CAMERA_POS + share * (goal - home)
        if not keeps_clear(home[None], goal, [panel]).all() or box_distance(eyes, panel).min() < CAMERA_ROOM_M / 2:
            return False
    way = home + share[::3] * (spec.oracle_path[meeting] - home)
    if box_distance(way[:, None] + _hand_points(), panel).min() < 0.0:
        return False
    return all(apart(panel, box, FIXTURE_ROOM_M) for box in launch.boxes) and _clear_of_string_and_striker(
        panel, spec, launch
    )


def _clear_of_string_and_striker(panel: Box, spec: EpisodeSpec, launch: Launch) -> bool:
    share = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
    clear = True
    if launch.tether is not None:
        string = spec.oracle_path[:, None] + share * (np.asarray(launch.tether.anchor) - spec.oracle_path[:, None])
        clear &= bool(box_distance(string, panel).min() > FIXTURE_ROOM_M)
    if (striker := launch.striker) is not None:
        times = np.arange(spec.intercept_frame + 1)[:, None] * CONTROL_DT
        balls = np.asarray(striker.pos) + times * np.asarray(striker.velocity)
        clear &= bool(box_distance(balls, panel).min() > striker.radius_m + FIXTURE_ROOM_M)
    return clear


def apart(panel: Box, other: Box, room_m: float) -> bool:
    """Tell whether an upright box across x is so far [m] from another box, by the axes that may separate them."""
    turned = quat_to_matrix(np.asarray(other.quat, float))
    edges = np.cross(np.eye(3)[:, None], turned.T[None]).reshape(-1, 3)
    axes = np.concatenate([np.eye(3), turned.T, edges])
    axes = axes[np.linalg.norm(axes, axis=1) > 1e-6]
    reach = np.abs(axes) @ (np.asarray(panel.half_size) + room_m) + np.abs(axes @ turned) @ np.asarray(other.half_size)
    return bool((np.abs(axes @ (np.asarray(panel.pos) - np.asarray(other.pos))) > reach).any())


def _launch(spec: EpisodeSpec) -> Launch:
    return spec.motion.launch(spec.target) if isinstance(spec.motion, PhysicalMotion) else Launch((0.0, 0.0, 0.0))


def _release_frame(spec: EpisodeSpec) -> int:
    """Return the first frame at which the target moves."""
    return int(np.ceil(_launch(spec).release_s / CONTROL_DT - 1e-9))
