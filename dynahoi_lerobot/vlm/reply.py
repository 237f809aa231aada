"""Strict parsing of the model's answer: anything that differs from the requested format is refused, with the reason."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dynahoi_lerobot.foundation.conventions import HAND_DOF
from dynahoi_lerobot.vlm.bounded_json import decode_json
from dynahoi_lerobot.vlm.failures import Cause, RequestFailure
from dynahoi_lerobot.vlm.prompt import HORIZON, SKILLS

MAX_ANSWER = 64 << 10
"""Characters; ten frames of 18 numbers take about 3,000."""
FENCE = "```"


class ReplyError(RequestFailure):
    """An answer that is not in the requested format; the message says why."""

    def __init__(self, message: str) -> None:
        super().__init__(Cause.UNPLAYABLE, message)


def parse_reply(text: str | None, horizon: int = HORIZON) -> np.ndarray:
    """Return the commands of an answer.

    A Markdown fence around the JSON is accepted, no other text is.

    Args:
        text: of the answer.
        horizon: number of frames that must be commanded.

    Returns:
        (horizon, 18) float64, palm centre position [m], home frame, and joint angles [rad], finite but not clipped.

    Raises:
        ReplyError: for a refusal, broken or oversized JSON, missing keys, unknown skills, durations that do not sum to
            ``horizon``, a wrong number of frames or values, and values that are not finite numbers.
    """
    if not text or not text.strip():
        raise ReplyError("the answer is empty")
    if len(text) > MAX_ANSWER:
        raise ReplyError(f"the answer has {len(text)} characters, more than {MAX_ANSWER}")
    answer = _decode(text)
    _check_program(_item(answer, "action_sequence", list), horizon)
    motion = _item(answer, "predicted_motion", list)
    if len(motion) != horizon:
        raise ReplyError(f"predicted_motion has {len(motion)} frames, not {horizon}")
    return np.array([_frame(frame, number) for number, frame in enumerate(motion, 1)])


def _decode(text: str) -> dict[str, Any]:
    body = text.strip()
    if body.startswith(FENCE):
        body = body.removeprefix(FENCE).removeprefix("json").removesuffix(FENCE)
    try:
        answer = decode_json(body)
    except ValueError as error:
        raise ReplyError(f"the answer is not JSON ({error}): {body[:80]!r}") from error
    if not isinstance(answer, dict):
        raise ReplyError(f"the answer is a JSON {type(answer).__name__}, not an object")
    return answer


def _item(mapping: Any, key: str, kind: type) -> Any:
    value = mapping.get(key) if isinstance(mapping, dict) else None
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ReplyError(f"{key} is missing or not a {kind.__name__}")
    return value


def _check_program(program: list[Any], horizon: int) -> None:
    for step in program:
        skill = _item(step, "skill", str)
        if skill not in SKILLS:
            raise ReplyError(f"unknown skill {skill[:40]!r}; known: {', '.join(SKILLS)}")
    durations = [_item(step, "duration", int) for step in program]
    if min(durations, default=0) < 1 or sum(durations) != horizon:
        raise ReplyError(f"the durations sum to {sum(durations)}, or one is below 1; they must sum to {horizon}")


def _frame(frame: Any, number: int) -> list[float]:
    values = _item(frame, "hand_params", list)
    if len(values) != HAND_DOF:
        raise ReplyError(f"frame {number} has {len(values)} values, not {HAND_DOF}")
    if not all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values):
        raise ReplyError(f"frame {number} has a value that is not a finite number")
    return [float(v) for v in values]
