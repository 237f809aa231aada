"""Index arithmetic: which frames and which actions belong to a decision.

A *decision* is a time step at which the policy predicts a chunk of actions. With history length ``s``
and stride ``r`` it sees frames ``-s r, ..., -r, 0`` relative to its own time step, and predicts the actions of
frames ``0 ... horizon - 1``.

Encoding images dominates training on a CPU, and the windows of neighbouring decisions overlap. A training
sample may therefore hold ``n_decisions`` decisions, ``decision_stride`` frames apart: every frame in the union
of their windows is loaded and encoded once, and the loss is computed at each decision. With ``s = 5, r = 2`` and
four decisions four frames apart, 12 encoded frames serve 4 decisions instead of 24 frames:

    decision 0   -10 -8 -6 -4 -2  0
    decision 1            -6 -4 -2  0  2  4
    decision 2                   -2  0  2  4  6  8
    decision 3                            2  4  6  8 10 12

A decision never attends to a frame after its own time step, so training stays causal although the sample holds
later frames.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DecisionWindows:
    """The frame offsets of one training sample. All values are in frames of the dataset.

    Attributes:
        n_obs_frames: observed frames before the current one, ``s``; 0 is the single-frame control.
        obs_stride: distance between observed frames.
        horizon: actions in a chunk.
        n_decisions: decisions in a sample.
        decision_stride: distance between those decisions.
        older_offsets: how far back a decision looks for older frames, besides.
        forgets_acting: whether it sees of those the ones of the observation window alone.
    """

    n_obs_frames: int
    obs_stride: int
    horizon: int
    n_decisions: int = 1
    decision_stride: int = 1
    older_offsets: tuple[int, ...] = ()
    forgets_acting: bool = True

    @property
    def decision_moments(self) -> list[int]:
        """Offsets of the decisions from the sample's own frame, shape ``(K,)`` [frames]."""
        return [k * self.decision_stride for k in range(self.n_decisions)]

    @property
    def lookback(self) -> list[int]:
        """Offsets a decision sees, oldest first and 0 last, shape ``(W,)`` [frames]."""
        recent = {-j * self.obs_stride for j in range(self.n_obs_frames + 1)}
        return sorted(recent | {-offset for offset in self.older_offsets})

    @property
    def seen_acting(self) -> list[bool]:
        """Whether each frame of `lookback` is seen even if it is not part of the observation window."""
        recent = range(0, self.n_obs_frames * self.obs_stride + 1, self.obs_stride)
        return [not self.forgets_acting or -back in recent for back in self.lookback]

    @property
    def observation_offsets(self) -> list[int]:
        """Every frame any decision sees, ascending and without repeats, shape ``(T,)`` [frames]."""
        return sorted({moment + back for moment in self.decision_moments for back in self.lookback})

    @property
    def action_offsets(self) -> list[int]:
        """Every action any decision predicts, ascending, shape ``(L,)`` [frames]."""
        return list(range(self.decision_moments[-1] + self.horizon))

    @property
    def frame_index(self) -> list[list[int]]:
        """Positions in ``observation_offsets`` of each decision's window, shape ``(K, s + 1)``."""
        position = {offset: i for i, offset in enumerate(self.observation_offsets)}
        return [[position[moment + back] for back in self.lookback] for moment in self.decision_moments]

    @property
    def action_index(self) -> list[list[int]]:
        """Positions in ``action_offsets`` of each decision's chunk, shape ``(K, horizon)``."""
        return [list(range(moment, moment + self.horizon)) for moment in self.decision_moments]
