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
    """Return a guide of the start of a chunk towards the unexecuted actions of the previous one.

    Args:
        processor: LeRobot's guidance.
        leftover: unexecuted actions as the head predicts them (see `ActionFrame`), shape ``(B, n, A)``, n up to the
            horizon.
        inference_delay: actions that will have been executed when the new chunk is ready [frames].
        execution_horizon: actions over which the guidance fades out; None uses that of the processor.
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
