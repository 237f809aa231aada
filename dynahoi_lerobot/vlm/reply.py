"""The model's answer as pydantic reads it: anything that differs from the requested format is refused."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from dynahoi_lerobot.core.conventions import HAND_DOF
from dynahoi_lerobot.vlm.prompt import HORIZON, SKILLS


class ReplyError(ValueError):
    """An answer that is not in the requested format; the message says why."""


class Step(BaseModel):
    """One skill of the program. The simulator plays the rollout, so a step changes no command."""

    skill: Literal[SKILLS]  # type: ignore[valid-type]
    duration: Annotated[int, Field(ge=1, le=HORIZON)]
    params: Any = None
    terminate_if: Any = None


class Frame(BaseModel):
    """One frame of the rollout: palm centre position [m], home frame, and joint angles [rad]."""

    hand_params: Annotated[list[FiniteFloat], Field(min_length=HAND_DOF, max_length=HAND_DOF)]


class Answer(BaseModel):
    """A skill program and the rollout of the next ``HORIZON`` frames (appendix "Details for Evaluating VLMs")."""

    action_sequence: Annotated[list[Step], Field(min_length=1)]
    predicted_motion: Annotated[list[Frame], Field(min_length=HORIZON, max_length=HORIZON)]

    @model_validator(mode="after")
    def _durations_fill_the_horizon(self) -> Self:
        if (total := sum(step.duration for step in self.action_sequence)) != HORIZON:
            raise ValueError(f"the durations sum to {total}; they must sum to {HORIZON}")
        return self


def parse_reply(text: str) -> tuple[np.ndarray, list[tuple[str, int]]]:
    """Return the commands of an answer and its skills; a Markdown fence around the JSON is accepted, no other text is.

    Returns:
        (10, 18) float64, palm centre position [m], home frame, and joint angles [rad], finite but not clipped; and the
        name of each skill with its duration [frames].

    Raises:
        ReplyError: if the text is not JSON or not an ``Answer``.
    """
    body = text.strip()
    if body.startswith("```"):
        body = body.removeprefix("```").removeprefix("json").removesuffix("```")
    try:
        answer = Answer.model_validate_json(body, strict=True)  # numbers are neither text nor truth values
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"])) or "the answer"
        raise ReplyError(f"{place}: {first['msg']}"[:200]) from None
    commands = np.array([frame.hand_params for frame in answer.predicted_motion], np.float64)
    return commands, [(step.skill, step.duration) for step in answer.action_sequence]
