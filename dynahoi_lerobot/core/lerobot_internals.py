"""What we use of LeRobot 0.6 that its documentation does not offer: a version that renames any of
it changes this module alone.

Policies use nothing of the core, and import the little that they need themselves.
"""

from __future__ import annotations

import inspect
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.arguments import BAD_INPUT

VIDEO_BACKEND_LOGGER = "lerobot.utils.import_utils"
"""Which warns in 100 lines that torchcodec finds no FFmpeg libraries, and that PyAV decodes
instead."""
ONE_EPISODE_OPTION = "lerobot_new_rollout"
"""Reset option of its evaluation: play one episode in every world, then wait for the next reset."""
RENAMING_STEP = "rename_observations_processor"
"""The processor step that applies ``--rename_map``."""


@contextmanager
def video_backend_unspoken() -> Iterator[None]:
    """Mute the warning about torchcodec; ``dynahoi doctor`` reports the problem in one line."""
    logger = logging.getLogger(VIDEO_BACKEND_LOGGER)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


# -- command lines ---------------------------------------------------------------------------------


def command_name() -> str:
    """Return the LeRobot command that runs, such as ``lerobot-eval``, if one does."""
    return Path(sys.argv[0]).stem.replace("_", "-")


def given(option: str) -> str | None:
    """Return the text of an option of the command line, such as ``env.task``; None without it."""
    from lerobot.configs import parser

    return parser.parse_arg(option)


def given_type(group: str) -> str | None:
    """Return the type of a group of options, such as ``env``; None if the command line names
    none.
    """
    from lerobot.configs import parser

    return parser.get_type_arg(group)


def given_words(group: str) -> list[str]:
    """Return the words of the command line that set options of a group, without its name and
    without the option that names a package of plugins.
    """
    from lerobot.configs import parser

    plugins = f"--{group}.{parser.PLUGIN_DISCOVERY_SUFFIX}"
    words = []
    skip = False
    for word in sys.argv[1:]:
        skip = word == plugins or (skip and not word.startswith("--"))
        if not skip and not word.startswith(f"{plugins}="):
            words.append(word)
    return parser.get_cli_overrides(group, words) or []


def given_policy() -> tuple[str | None, list[str]]:
    """Return the path of the policy of the command line or its config file, and the words that
    change its config.
    """
    from lerobot.configs import parser

    return parser.get_path_arg("policy"), [
        *parser.get_yaml_overrides("policy"),
        *given_words("policy"),
    ]


@contextmanager
def mistakes_in_a_sentence() -> Iterator[None]:
    """End the process with one sentence and exit code 2 where a ValueError is raised, or draccus
    cannot read an option: LeRobot would print a traceback, after it has loaded everything else.
    """
    from draccus.utils import DraccusException

    try:
        yield
    except (ValueError, DraccusException) as error:
        sentence = " ".join(str(error.__cause__ or error).split())
        print(f"{command_name()}: {sentence}", file=sys.stderr)
        sys.exit(BAD_INPUT)


RECORDING_LOOPS = {"record_loop": "start_episode_t", "EpisodicStrategy._policy_loop": "start_t"}
"""Functions of ``lerobot-record`` and of the episodic ``lerobot-rollout`` that run through one
episode, or wait for a reset, with the local variable that says when that began."""
BETWEEN_EPISODES = "EpisodicStrategy.run"  # calls the robot there, too


def recording_loop() -> tuple[float, bool] | None:
    """Return when LeRobot's loop over an episode began that calls this, and whether it records;
    None for a caller that has no episodes.

    LeRobot tells a robot neither that an episode begins, nor that it waits for a reset.
    """
    frame = inspect.currentframe()
    while frame := frame and frame.f_back:
        name = frame.f_code.co_qualname
        if name in RECORDING_LOOPS:
            told = frame.f_locals
            return told.get(RECORDING_LOOPS[name], 0.0), told.get("dataset") is not None
        if name == BETWEEN_EPISODES:
            return 0.0, False
    return None


# -- policies --------------------------------------------------------------------------------------


def accepts_guidance(policy: Any) -> bool:
    """Whether a policy offers real-time chunking."""
    from lerobot.rollout.inference.rtc import supports_rtc_inference

    return supports_rtc_inference(policy)


def prepare_guidance(policy: Any) -> None:
    """Set real-time chunking up as ``lerobot-rollout`` does, with LeRobot's defaults if the
    checkpoint has none.
    """
    from lerobot.policies.rtc import RTCConfig

    policy.config.rtc_config = policy.config.rtc_config or RTCConfig()
    if hasattr(policy, "init_rtc_processor"):
        policy.init_rtc_processor()


def as_policies_take(observation: dict[str, Any]) -> dict[str, Any]:
    """Return a Gymnasium observation of N worlds by LeRobot's keys, as ``lerobot-eval`` does."""
    from lerobot.envs.utils import preprocess_observation

    return preprocess_observation(observation)


def queued_frame(policy: Any, batch: dict[str, Any]) -> dict[str, Any]:
    """Add a frame to the observation queues of a policy that has them (Diffusion Policy, VQ-BeT,
    multi-task DiT).

    Returns:
        The batch as ``predict_action_chunk`` of such a policy takes it: its images are stacked
        under one key.
    """
    import torch
    from lerobot.policies.utils import populate_queues
    from lerobot.utils.constants import ACTION, OBS_IMAGES

    queues = getattr(policy, "_queues", None) or {}
    if OBS_IMAGES in queues:
        images = [batch[key] for key in policy.config.image_features]
        batch = batch | {OBS_IMAGES: torch.stack(images, dim=-4)}
    if queues:
        # a policy looks into the queue of every key of the batch, and that of actions may be empty
        batch = {key: value for key, value in batch.items() if key != ACTION}
    populate_queues(queues, batch)
    return batch
