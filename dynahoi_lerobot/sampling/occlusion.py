"""What a panel hides from the hand's camera: silhouettes of the target on an upright plane, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.foundation.products import norm
from dynahoi_lerobot.hands.gantry import CAMERA_POS
from dynahoi_lerobot.motions.launch import Box
from dynahoi_lerobot.objects import TargetObject

INNER_SHARE = 0.8
"""A sphere of so much of the grasp radius is taken to be part of the target, however it is turned."""
SLIVER_M = 0.006
"""What shows of that sphere beside the panel does not count if it is narrower than this, about a pixel."""
STEEPEST_RAD = 1.5
"""Lines of sight that are more oblique to the panel do not count."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Who looks at what until the target can be met, at frame M.

    Attributes:
        eyes_w: (2, M, 3) the camera at every frame [m], world: of the waiting hand, and of one that goes straight to
            the meeting from control start on.
        target_w: (M, 3) the untouched target's centre [m], world.
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
    def until(cls, spec: EpisodeSpec, meeting: int) -> Sight:
        """Return the sight of an episode until frame ``meeting``, which lies in its control phase."""
        share = (np.arange(meeting) - spec.window_frames) / (meeting - spec.window_frames)
        way = np.maximum(share, 0.0)[:, None] * (spec.oracle_path[meeting] - spec.home_pos_w)
        waiting = np.tile(spec.home_pos_w + CAMERA_POS, (meeting, 1))
        release_s = spec.motion.launch(spec.target).release_s
        return cls(
            eyes_w=np.stack([waiting, waiting + way]),
            target_w=spec.oracle_path[:meeting],
            radius_m=enclosing_radius_m(spec.target),
            inner_m=INNER_SHARE * spec.target.grasp_radius_m,
            release_frame=int(np.ceil(release_s / CONTROL_DT - 1e-9)),
            window_frames=spec.window_frames,
        )

    def hidden(self, panel: Box) -> np.ndarray:
        """Tell from which eye, at which frames, the panel hides all of the target for certain: (2, M) bool."""
        return self._covered(panel, self.radius_m, 0.0)

    def lost(self, panel: Box) -> np.ndarray:
        """Tell from which eye, at which frames, the panel may leave no pixel of the target: (2, M) bool."""
        return self._covered(panel, self.inner_m, SLIVER_M)

    def _covered(self, panel: Box, radius_m: float, sliver_m: float) -> np.ndarray:
        low, high = silhouette(self.eyes_w, self.target_w, panel.pos[0], radius_m)
        middle, half = np.asarray(panel.pos[1:]), np.asarray(panel.half_size[1:]) + sliver_m
        return np.all((low >= middle - half) & (high <= middle + half), axis=-1)


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


def enclosing_radius_m(target: TargetObject) -> float:
    """Return the radius [m] of a sphere around the centre that holds all of an object."""
    return max(norm(part.pos) + _EXTENTS[part.shape](np.asarray(part.half_size)) for part in target.primitives)


_EXTENTS = {
    "sphere": lambda half: float(half[0]),
    "capsule": lambda half: float(half[0] + half[1]),
    "cylinder": lambda half: float(np.hypot(half[0], half[1])),
    "ellipsoid": lambda half: float(half.max()),
    "box": norm,
}
"""How far each shape reaches from its centre [m], from its (3,) half-sizes."""
