"""The screen of protocol ``occluded``: an upright panel behind which the target vanishes before a
hand can meet it.

The panel stands across the view, between the hand's camera and the target. It is as large as it
must be to hide the target from home and from the straight way of a hand that meets it as early as
it can. It is only drawn; hand and target keep clear of it nevertheless.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, SCREEN_STREAM, frames_until
from dynahoi_lerobot.core.numerics import arcsin, arctan2, norm, product, quat_to_matrix, runs, tan
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES, DEFAULT_CONTROL_CLASS
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.hands.base import CAMERA_POS
from dynahoi_lerobot.motions.launch import Box, Launch
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.scene.appearance import Solid, hsv
from dynahoi_lerobot.scene.clearance import box_distance, hand_points, keeps_clear

HIDDEN_FRAMES = (8, 7, 6)
"""Frames for which a panel is made, in the order tried; as the target goes in and comes out, some
may add to them."""
MAX_HIDDEN_FRAMES = 12
"""The target is hidden no longer than this, 0.6 s, before it can be met."""
RETURN_FRAMES = (0, 1, 2, 3)
"""How many frames before the meeting the target may come out again, in the order tried."""
MIN_SEEN_FRAMES, MIN_SEEN_BEFORE_FRAMES = 4, 3
"""Least frames of the window in which a moving target is not hidden, and least of all frames before
it vanishes."""
FAST_HAND_M_S = CONTROL_CLASSES[DEFAULT_CONTROL_CLASS].palm_speed_m_s
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
INNER_SHARE = 0.8
"""A sphere of so much of the grasp radius is taken to be part of the target, however it is
turned."""
SLIVER_M = 0.006
"""What shows of that sphere beside the panel does not count if it is narrower than this, about a
pixel."""
STEEPEST_RAD = 1.5
"""Lines of sight that are more oblique to the panel do not count."""
CAMERA_CLEARANCE_M, TARGET_CLEARANCE_M, FIXTURE_CLEARANCE_M = 0.02, 0.01, 0.01
"""Least distances of a screen from the camera, and from the surfaces of target, fixtures, string
and striker."""
HAND_POSES = 8
STRING_POINTS = 24


@dataclass(frozen=True, eq=False)
class Sight:
    """Who looks at what until the target can be met, at frame M.

    Attributes:
        eyes_w: (2, M, 3) the camera at every frame [m], world: of the waiting hand, and of one that
            goes straight to the meeting from control start on.
        target_w: (M, 3) the untouched target's center [m], world.
        radius_m: of the sphere around the target.
        inner_m: of a sphere within it.
        release_frame: first frame at which the target moves.
        window_frames: length of the observation window.
    """

    eyes_w: np.ndarray
    target_w: np.ndarray
    radius_m: float
    inner_m: float
    release_frame: int
    window_frames: int

    @classmethod
    def until(cls, spec: EpisodeSpec, meeting: int) -> Self:
        """Return the sight of an episode until frame ``meeting``, which lies in its control
        phase.
        """
        share = (np.arange(meeting) - spec.window_frames) / (meeting - spec.window_frames)
        way = np.maximum(share, 0.0)[:, None] * (spec.target_path_w[meeting] - spec.home_pos_w)
        waiting = np.tile(spec.home_pos_w + CAMERA_POS, (meeting, 1))
        release_s = spec.motion.launch(spec.target).release_s
        return cls(
            eyes_w=np.stack([waiting, waiting + way]),
            target_w=spec.target_path_w[:meeting],
            radius_m=enclosing_radius_m(spec.target),
            inner_m=INNER_SHARE * spec.target.grasp_radius_m,
            release_frame=frames_until(release_s),
            window_frames=spec.window_frames,
        )

    def hidden(self, panel: Box) -> np.ndarray:
        """Tell from which eye, at which frames, the panel hides all of the target for certain: (2,
        M) bool.
        """
        return self._covered(panel, self.radius_m, 0.0)

    def lost(self, panel: Box) -> np.ndarray:
        """Tell from which eye, at which frames, the panel may leave no pixel of the target: (2, M)
        bool.
        """
        return self._covered(panel, self.inner_m, SLIVER_M)

    def _covered(self, panel: Box, radius_m: float, sliver_m: float) -> np.ndarray:
        low, high = silhouette(self.eyes_w, self.target_w, panel.pos[0], radius_m)
        middle = np.asarray(panel.pos[1:])
        half = np.asarray(panel.half_size[1:]) + sliver_m
        return np.all((low >= middle - half) & (high <= middle + half), axis=-1)


def with_screen(spec: EpisodeSpec) -> EpisodeSpec | None:
    """Return the episode with a screen, or None if none can be placed; the screen draws from
    numbers of its own.
    """
    panel = place_panel(spec)
    if panel is None:
        return None
    rng = np.random.default_rng([SCREEN_STREAM, spec.seed])
    color = hsv(rng.random(), rng.uniform(0.0, 0.6), rng.uniform(0.3, 0.9))
    return replace(
        spec,
        appearance=replace(spec.appearance, screen=Solid("box", panel.half_size, panel.pos, color)),
    )


def place_panel(spec: EpisodeSpec) -> Box | None:
    """Return the first panel that hides the target as it should and stands in nobody's way, or
    None.
    """
    meeting = earliest_meeting(spec)
    sight = Sight.until(spec, meeting)
    for back, length in itertools.product(RETURN_FRAMES, HIDDEN_FRAMES):
        behind = np.arange(meeting - back - length, meeting - back)
        if min(behind[0], spec.window_frames) - sight.release_frame < MIN_SEEN_BEFORE_FRAMES:
            continue
        for panel in _panels(sight, behind):
            if _vanishes(sight, panel, behind) and stands_clear(
                panel, spec, meeting, sight.radius_m
            ):
                return panel
    return None


def earliest_meeting(spec: EpisodeSpec) -> int:
    """Return the first frame at which a hand of ``FAST_HAND_M_S`` that starts with the control
    phase is there.
    """
    frames = np.arange(spec.horizon_frames) - spec.window_frames
    distance = np.linalg.norm(spec.target_path_w - spec.home_pos_w, axis=1)
    reached = (frames >= FEWEST_APPROACH_FRAMES) & (distance <= FAST_HAND_M_S * CONTROL_DT * frames)
    return int(reached.argmax())  # there is one: a hand of 0.3 m/s reaches the intercept


def _panels(sight: Sight, behind: np.ndarray) -> Iterator[Box]:
    """Yield panels behind which the target is at the frames ``behind`` (n,), as small as each depth
    allows.
    """
    eyes = sight.eyes_w[:, behind]
    target = sight.target_w[behind]
    nearest = eyes[..., 0].max() + CAMERA_ROOM_M
    farthest = target[:, 0].min() - sight.radius_m - TARGET_CLEARANCE_M
    if nearest > farthest:
        return
    for share in DEPTHS:
        x = nearest + share * (farthest - nearest)
        low, high = silhouette(eyes, target, x, sight.radius_m + SPARE_M)
        low = low.min(axis=(0, 1))
        high = high.max(axis=(0, 1))
        if (high - low).max() <= LARGEST_M and low[1] > FIXTURE_CLEARANCE_M:
            (y, z), (half_y, half_z) = (low + high) / 2, (high - low) / 2
            yield Box(
                (float(x), float(y), float(z)), (HALF_THICKNESS_M, float(half_y), float(half_z))
            )


def _vanishes(sight: Sight, panel: Box, behind: np.ndarray) -> bool:
    """Tell whether both eyes lose the target at the frames ``behind``, never for too long, and saw
    it before.
    """
    lost = sight.lost(panel)
    seen = (~lost[:, sight.release_frame : sight.window_frames]).sum(axis=1)
    return bool(
        sight.hidden(panel)[:, behind].all()
        and all(end - start <= MAX_HIDDEN_FRAMES for eye in lost for start, end in runs(eye))
        and (seen >= MIN_SEEN_FRAMES).all()
    )


def silhouette(
    eyes_w: np.ndarray, centers_w: np.ndarray, x: float, radius_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return what of an upright plane across x lies before a sphere.

    Args:
        eyes_w: (..., 3) where it is seen from [m], world.
        centers_w: (..., 3) of the sphere [m], world.
        x: of the plane [m], world.
        radius_m: of the sphere.

    Returns:
        Lowest and highest y and z (..., 2) [m], world; infinite where the plane is not between the
        two.
    """
    offset = centers_w - eyes_w
    ahead = offset[..., :1]
    aside = offset[..., 1:]
    middle = arctan2(aside, ahead)
    half = arcsin(np.clip(radius_m / np.maximum(np.sqrt(ahead**2 + aside**2), radius_m), 0.0, 1.0))
    gap = x - eyes_w[..., :1]
    between = (gap > 0) & (ahead - radius_m > gap) & (np.abs(middle) + half < STEEPEST_RAD)
    low = np.where(between, eyes_w[..., 1:] + gap * tan(middle - half), -np.inf)
    return low, np.where(between, eyes_w[..., 1:] + gap * tan(middle + half), np.inf)


def enclosing_radius_m(target: TargetObject) -> float:
    """Return the radius [m] of a sphere around the center that holds all of an object."""
    return max(
        norm(part.pos) + _EXTENTS[part.shape](np.asarray(part.half_size))
        for part in target.primitives
    )


_EXTENTS = {
    "sphere": lambda half: float(half[0]),
    "capsule": lambda half: float(half[0] + half[1]),
    "cylinder": lambda half: norm(half[:2]),
    "ellipsoid": lambda half: float(half.max()),
    "box": norm,
}
"""How far each shape reaches from its center [m], from its (3,) half-sizes."""


def stands_clear(panel: Box, spec: EpisodeSpec, meeting: int, radius_m: float) -> bool:
    """Tell whether a panel across x stands in nobody's way; a sphere of ``radius_m`` encloses the
    target.

    All of the open hand keeps clear on its way to where a fast hand meets the target, at frame
    ``meeting``, and the palm center also on the way to the episode's intercept.
    """
    home = spec.home_pos_w
    launch = spec.motion.launch(spec.target)
    return (
        bool(box_distance(spec.target_path_w, panel).min() > radius_m + TARGET_CLEARANCE_M)
        and all(apart(panel, box, FIXTURE_CLEARANCE_M) for box in launch.boxes)
        and _clear_of_string(panel, launch, spec.target_path_w)
        and _clear_of_striker(panel, launch, spec.intercept_frame)
        and _clear_of_hand(panel, home, spec.target_path_w[meeting], hand_points())
        and _clear_of_hand(panel, home, spec.intercept_pos_w, np.zeros((1, 3)))
    )


def _clear_of_hand(panel: Box, home_w: np.ndarray, goal_w: np.ndarray, points: np.ndarray) -> bool:
    """Tell whether a panel is off the waiting hand, and off palm center and camera on a straight
    way.

    The palm center keeps as far from it as from fixtures; ``points`` (P, 3) of the hand must not be
    in it.
    """
    way = home_w + np.linspace(0.0, 1.0, HAND_POSES)[:, None] * (goal_w - home_w)
    return (
        bool(keeps_clear(home_w[None], goal_w, [panel]).all())
        and bool(box_distance(way + CAMERA_POS, panel).min() > CAMERA_CLEARANCE_M)
        and bool(box_distance(way[:, None] + points, panel).min() > 0.0)
    )


def _clear_of_string(panel: Box, launch: Launch, path_w: np.ndarray) -> bool:
    if launch.tether is None:
        return True
    share = np.linspace(0.0, 1.0, STRING_POINTS)[:, None]
    string = path_w[:, None] + share * (np.asarray(launch.tether) - path_w[:, None])  # (F, P, 3)
    return bool(box_distance(string, panel).min() > FIXTURE_CLEARANCE_M)


def _clear_of_striker(panel: Box, launch: Launch, frames: int) -> bool:
    striker = launch.striker
    if striker is None:
        return True
    times = np.arange(frames + 1)[:, None] * CONTROL_DT
    balls = np.asarray(striker.pos) + times * np.asarray(striker.velocity)
    return bool(box_distance(balls, panel).min() > striker.radius_m + FIXTURE_CLEARANCE_M)


def apart(panel: Box, other: Box, room_m: float) -> bool:
    """Tell whether an upright box across x is so far [m] from another box, by the axes that may
    separate them.
    """
    turned = quat_to_matrix(np.asarray(other.quat, float))
    edges = np.cross(np.eye(3)[:, None], turned.T[None]).reshape(-1, 3)
    axes = np.concatenate([np.eye(3), turned.T, edges])
    axes = axes[np.linalg.norm(axes, axis=1) > 1e-6]
    reach = product(np.abs(axes), np.asarray(panel.half_size) + room_m)
    reach += product(np.abs(product(axes, turned)), np.asarray(other.half_size))
    return bool(
        (np.abs(product(axes, np.asarray(panel.pos) - np.asarray(other.pos))) > reach).any()
    )
