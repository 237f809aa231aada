"""EpisodeSpec: the parameters of one episode, a function of recipe and seed alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from dynahoi_lerobot.motions import Motion
    from dynahoi_lerobot.objects import TargetObject
    from dynahoi_lerobot.scene.appearance import Appearance


@dataclass(frozen=True, eq=False)
class EpisodeSpec:
    """Everything that is drawn for one episode, and what follows from it before any hand moves.

    World frame, SI units; frames are 0.05 s apart and counted from the start of the episode.

    Attributes:
        seed: of the episode's random numbers, together with ``split``.
        split: name of the seed stream.
        motion: the target's motion with its parameters.
        target: the object to catch.
        appearance: textures, colors and light.
        task: the instruction.
        protocol: one of ``protocols.PROTOCOLS``.
        hand: registered name of the hand.
        open_joints: (15,) joint angles of the open hand [rad], in which it waits.
        reference_joints: (15,) joint angles of the reference grasp [rad], which closes the hand
            around the target.
        window_frames: length of the observation window, 0 without one.
        length_frames: L, length of the expert's recording; a policy gets L control steps.
        home_pos_w: (3,) palm center at the start [m].
        intercept_frame: the earliest frame at which a hand of fixed speed can reach the untouched
            target.
        intercept_pos_w: (3,) position of the target at that frame [m].
        yaw_rad: initial turn about the vertical of a target on a prescribed path.
        spin_rad_s: constant angular velocity of such a target about its own z axis.
        target_path_w: (F, 3) position of the untouched target at every frame [m], F = window + L +
            1.
        code: fingerprint of the code that drew it.
    """

    seed: int
    split: str
    motion: Motion
    target: TargetObject
    appearance: Appearance
    task: str
    protocol: str
    hand: str
    open_joints: np.ndarray
    reference_joints: np.ndarray
    window_frames: int
    length_frames: int
    home_pos_w: np.ndarray
    intercept_frame: int
    intercept_pos_w: np.ndarray
    yaw_rad: float
    spin_rad_s: float
    target_path_w: np.ndarray = field(repr=False)
    code: str

    @property
    def intercept_pos_h(self) -> np.ndarray:
        """(3,) position of the untouched target at the intercept [m], home frame."""
        return self.intercept_pos_w - self.home_pos_w

    @property
    def horizon_frames(self) -> int:
        """F, the number of frames for which the target's motion is known."""
        return len(self.target_path_w)
