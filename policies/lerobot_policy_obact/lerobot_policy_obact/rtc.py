"""Real-time chunking: LeRobot's `RTCProcessor` as a `Guide` of our flow.

LeRobot's flow time runs from 1 (noise) to 0 (data) and its velocity points from data to noise; ours run the
other way. With ``s = 1 - t`` the same path has ``dx/ds = -dx/dt``, so time and velocity both change sign on
the way in, and the guided velocity changes sign on the way out.
"""

from __future__ import annotations

from lerobot.policies.rtc import RTCProcessor
from torch import Tensor

from .heads.base import Guide, Velocity


def rtc_guide(
    processor: RTCProcessor, leftover: Tensor, inference_delay: int, execution_horizon: int | None = None
) -> Guide:
    """Return a guide that draws the start of a chunk towards the unexecuted rest of the last one.

    Args:
        processor: LeRobot's guidance.
        leftover: Unexecuted actions in the frame of the head, shape ``(B, n, A)`` with n up to the horizon.
        inference_delay: Actions that will have been executed when the new chunk is ready.
        execution_horizon: Actions over which the pull fades, None for the processor's own.
    """

    def guide(x_t: Tensor, t: float, velocity: Velocity) -> Tensor:
        return -processor.denoise_step(
            x_t=x_t,
            prev_chunk_left_over=leftover,
            inference_delay=inference_delay,
            time=1 - t,
            original_denoise_step_partial=lambda x: -velocity(x),
            execution_horizon=execution_horizon,
        )

    return guide
