"""What has pictures: an observation and an episode name them alike."""

from __future__ import annotations

import numpy as np


class Pictured:
    """Something with the images of the hand's camera, and those of further views.

    Attributes:
        images: (N, H, W, 3) uint8 RGB, or None where nothing was rendered.
        views: further pictures by name, of the same shape; see `camera_views.py`.
    """

    images: np.ndarray | None
    views: dict[str, np.ndarray]

    @property
    def pictures(self) -> dict[str, np.ndarray]:
        """Every picture by the name of its view, the hand's camera first; none where nothing was rendered."""
        return {} if self.images is None else {"ego": self.images, **self.views}
