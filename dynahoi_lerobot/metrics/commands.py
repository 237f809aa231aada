"""Steps between 18-D commands in the authors' mixed units, for the legacy scores."""

from __future__ import annotations

import numpy as np

from dynahoi_lerobot.episode import Episode
from dynahoi_lerobot.foundation.conventions import PALM_DOF, UNIT_M
from dynahoi_lerobot.metrics.trajectory import until_localized

LEGACY_REST = 1e-4
"""Steps up to this length (u and rad mixed) are dropped, as in the authors' evaluation."""


def command_steps(episode: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Return the (K, 18) steps between successive commands, tiny ones dropped, and (18,) the displacement.

    Palm positions are in u and joint angles in radians, because that mixture is what the authors' code
    measured.
    """
    points = episode.executed[until_localized(episode)].astype(np.float64)  # (M, 18)
    points[:, :PALM_DOF] /= UNIT_M
    steps = np.diff(points, axis=0)
    return steps[np.linalg.norm(steps, axis=1) > LEGACY_REST], points[-1] - points[0]
