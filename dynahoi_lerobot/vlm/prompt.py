"""The prompts for a vision-language model (appendix "Details for Evaluating VLMs")."""

from string import Template
from typing import Any

import cv2
import numpy as np

from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_NAMES
from dynahoi_lerobot.core.escaping import data_url

HORIZON = 10
"""T, the number of frames of 0.05 s that one answer commands."""
SKILLS = ("WAIT", "APPROACH", "INTERCEPT", "GRASP", "LIFT", "ADJUST")

SYSTEM = "You are a Vision-Language-Action agent for dynamic hand-object interaction."
PAPER = """Task. $task
Input. RGB image + current hand state s_t ∈ R^18: [x, y, z, 15 joint angles (rad)] = $state.
Skill Set. {$skills}.
Output. Return (i) a parameterized skill program whose durations sum to $horizon, and (ii) an \
explicit low-level rollout of the next $horizon frames, each with 18 values in the same order.
Return only the following JSON:
{
  "action_sequence": [
    {
      "skill": "APPROACH",
      "params": {"target": "object",......},
      "duration": 4,
      "terminate_if": ...,
    },
    {
      "skill": "GRASP",
      "params": {...},
      "duration": 6
    }
  ],
  "predicted_motion": [
    {"frame_index": 1, "hand_params": [18 values]},
    ...,
    {"frame_index": $horizon, "hand_params": [18 values]}
  ]
}"""
"""Figure "Hybrid prompt template for VLM online control", verbatim: <TASK_TEXT>, the state and T
are filled in."""

EXTENDED = """Task: $task
Input: the RGB image of the camera on the hand, and the current hand state s_t, 18 numbers \
[x, y, z in meters (from where the palm started, z up), 15 joint angles in radians, 0 open to 1.6 \
closed]: $state
The order of the joints is $names. The palm faces +x; one frame lasts 0.05 s; the palm moves \
at most $palm_step m a frame.
Skill set: {$skills}.
Output: (i) a parameterized skill program whose durations sum to $horizon, and (ii) an explicit \
low-level rollout of the next $horizon frames, each with 18 values in the same order.
Return only the following JSON:
{"action_sequence": [{"skill": "APPROACH", "params": {"target": "object"}, "duration": 4}, ...],
 "predicted_motion": [{"frame_index": 1, "hand_params": [18 values]}, ..., \
{"frame_index": $horizon, "hand_params": [18 values]}]}"""
"""The same, with what the paper's prompt leaves out: units, axes, joint order, frame rate and
speed."""

PROMPTS = {"extended": Template(EXTENDED), "paper": Template(PAPER)}
"""By the name that ``--prompt`` takes and that results carry. Both ask for the same answer, but for
``terminate_if``.

The paper gives ``terminate_if`` no grammar, and says that the simulator receives the rollout. So an
answer may hold any value there; as the skills themselves, it changes no command."""


DEFAULT_PROMPT = "extended"


def messages(
    prompt: str, palm_speed_m_s: float, task: str, state: np.ndarray, image: np.ndarray
) -> list[dict[str, Any]]:
    """Return the chat messages of one request: system, then user with text and a JPEG image.

    Args:
        prompt: one of ``PROMPTS``.
        palm_speed_m_s: the palm's greatest speed in the episodes [m/s], which ``extended`` tells.
        task: the instruction.
        state: (18,) palm center position [m], home frame, and joint angles [rad].
        image: (H, W, 3) uint8 RGB of the hand's camera.
    """
    text = PROMPTS[prompt].substitute(
        task=task,
        state=np.round(state.astype(float), 4).tolist(),
        names=", ".join(HAND_NAMES[3:]),
        skills=", ".join(SKILLS),
        horizon=HORIZON,
        palm_step=f"{palm_speed_m_s * CONTROL_DT:.4g}",
    )
    content = [
        {"type": "text", "text": text},
        {"type": "image_url", "image_url": {"url": _data_url(image)}},
    ]
    return [{"role": "system", "content": SYSTEM}, {"role": "user", "content": content}]


def _data_url(image: np.ndarray) -> str:
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 85])[
        1
    ]  # the quality of the paper's logger
    return data_url("image/jpeg", jpeg.tobytes())
