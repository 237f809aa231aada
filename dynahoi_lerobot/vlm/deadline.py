"""The time limit of one decision."""

from __future__ import annotations

import time

from dynahoi_lerobot.vlm.failures import Cause, RequestFailure


class Deadline:
    """A point in time after which an exchange is over."""

    def __init__(self, seconds: float) -> None:
        """Set it ``seconds`` [s] from now."""
        self._end, self._seconds = time.monotonic() + seconds, seconds

    @property
    def passed(self) -> bool:
        """Whether no time is left."""
        return time.monotonic() >= self._end

    def pause(self, seconds: float) -> bool:
        """Sleep for ``seconds`` [s] if that leaves time, else not at all; return whether it did."""
        if seconds >= self._end - time.monotonic():
            return False
        time.sleep(seconds)
        return True

    def remaining(self) -> float:
        """Return the time left [s], always positive.

        Raises:
            RequestFailure: with cause `Cause.TIMEOUT` if none is left.
        """
        left = self._end - time.monotonic()
        if left <= 0:
            raise RequestFailure(Cause.TIMEOUT, f"no complete answer within {self._seconds:.3g} s")
        return left
