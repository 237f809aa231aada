"""EpisodeSpec: one episode as one frozen row of parameters, a pure function of (recipe, seed)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynahoi_lerobot.appearance import Appearance
from dynahoi_lerobot.foundation.conventions import CONTROL_DT
from dynahoi_lerobot.motions import Motion
from dynahoi_lerobot.objects import TargetObject


@dataclass(frozen=True, eq=False)
class EpisodeSpec:
    """Everything that is drawn for one episode, and what follows from it before any hand moves.

    World frame, SI units; frames are 0.05 s apart and counted from the start of the episode.

    Attributes:
        seed: the seed that all of this is a function of.
        split: its seed stream.
        motion: the target's motion with its parameters.
        target: the object.
        appearance: textures, colours, light.
        task: the instruction.
        protocol: ``observe_before_act`` or ``direct_act``.
        hand: the embodiment.
        window_frames: length of the observation window.
        length_frames: L, length of the expert's recording; a policy gets L control steps.
        home_pos_w: (3,) palm centre at the start [m].
        intercept_frame: the earliest frame at which a hand of fixed speed can meet the target.
        intercept_pos_w: (3,) where that is [m].
        yaw_rad: initial turn of a prescribed target about the vertical.
        spin_rad_s: its constant angular speed about its own axis.
        oracle_path: (F, 3) position of the untouched target at every frame [m], F = window + L + 1.
        fingerprint: of recipe and code.
    """

    seed: int
    split: str
    motion: Motion
    target: TargetObject
    appearance: Appearance
    task: str
    protocol: str
    hand: str
    window_frames: int
    length_frames: int
    home_pos_w: np.ndarray
    intercept_frame: int
    intercept_pos_w: np.ndarray
    yaw_rad: float
    spin_rad_s: float
    oracle_path: np.ndarray = field(repr=False)
    fingerprint: str

    @property
    def intercept_time_s(self) -> float:
        """Time of the intercept from the start of the episode [s]."""
        return self.intercept_frame * CONTROL_DT

    @property
    def travel_m(self) -> float:
        """Straight distance from home to the intercept."""
        return float(np.linalg.norm(self.intercept_pos_w - self.home_pos_w))

    @property
    def horizon_frames(self) -> int:
        """F, the number of frames for which the target's motion is known."""
        return len(self.oracle_path)
