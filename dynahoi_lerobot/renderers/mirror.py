"""Fields of a batch of worlds, copied to a device: the chosen worlds into the first rows."""

from __future__ import annotations

import numpy as np
import warp as wp


class Mirror:
    """Device arrays that follow arrays of the batch.

    Attributes:
        arrays: by name, one row per world, of which the first are in use.
    """

    def __init__(self, sources: dict[str, np.ndarray], arrays: dict[str, wp.array]) -> None:
        """Let each of ``arrays`` follow the source of the same name, a live (N, ...) array of the batch."""
        self.arrays = arrays
        self._sources = sources
        self._staging = {
            name: array if str(array.device) == "cpu" else wp.empty_like(array, device="cpu")
            for name, array in arrays.items()
        }
        self._rows = {name: array.numpy() for name, array in self._staging.items()}

    def copy(self, ids: np.ndarray) -> None:
        """Move the rows ``ids`` of every field to the first rows of its device array."""
        for name, source in self._sources.items():
            rows = self._rows[name][: len(ids)]
            rows[...] = source[ids].reshape(rows.shape)
            if self._staging[name] is not self.arrays[name]:
                wp.copy(self.arrays[name][: len(ids)], self._staging[name][: len(ids)])  # type: ignore[arg-type] - slices of arrays are arrays
