"""The arguments of ``dynahoi evaluate``."""

from __future__ import annotations

import argparse

from dynahoi_lerobot.evaluate.actors import TRAINED_FOR, add_trust_argument
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.foundation.arguments import add_field_arguments, number, path, whole
from dynahoi_lerobot.rollout.inference import INFERENCE_MODES, MAX_LATENCY_MS, SYNC
from dynahoi_lerobot.sampling.recipe import PLAYING, Recipe
from dynahoi_lerobot.sampling.splits import SMALL_TEST
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, PROMPTS

RECIPE_OPTIONS = tuple(name for name in PLAYING if name not in ("split", "views"))
"""Fields of the recipe that are options of the command; the policy decides the views."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi evaluate``."""
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument(
        "--replay", type=path, metavar="RESULTS", help="replay the commands of a result folder and compare every number"
    )
    task.add_argument(
        "--policy",
        help=f"checkpoint folder, Hub repository, vlm, or privileged baseline: expert, {', '.join(EXPERTS.names())}",
    )
    parser.add_argument("--split", default=SMALL_TEST, help="test, test_small, val or one of the ood_ splits")
    parser.add_argument("--out", type=path, help="result folder; resumes where an earlier run stopped")
    parser.add_argument(
        "--episodes",
        type=int,
        help="number of episodes, from the first of the split, with --replay drawn at random; all by default",
    )
    parser.add_argument(
        "--replay-seed",
        type=whole(0, 2**32 - 1),
        help="with --replay: draws the same episodes as the run that printed it",
    )
    notes = dict.fromkeys(TRAINED_FOR, "what the policy was trained for by default")
    notes |= {"environment_state": "results are then marked as privileged"}
    add_field_arguments(parser, Recipe, RECIPE_OPTIONS, **notes)
    parser.add_argument(
        "--batch-size",
        type=whole(1, 4096),
        default=32,
        help="worlds simulated together; no influence on the result, and 1 for policies with --inference-ms measured",
    )
    parser.add_argument("--gifs", type=whole(0, 10**6), default=0, help="number of episodes to record as GIFs in --out")
    parser.add_argument("--per-kind", action="store_true", help="also print a row for each motion")
    _add_policy_arguments(parser)


def _add_policy_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what concerns LeRobot policies and vision-language models."""
    parser.add_argument("--device", help="torch device of the policy")
    add_trust_argument(parser)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a field of the policy's config, such as n_action_steps=2, a dictionary as JSON; may be repeated",
    )
    parser.add_argument(
        "--inference",
        choices=INFERENCE_MODES,
        default=SYNC,
        help="; ".join(f"{mode}: {meaning}" for mode, meaning in INFERENCE_MODES.items()),
    )
    parser.add_argument(
        "--inference-ms",
        type=_latency,
        default=0.0,
        metavar="MS",
        help="with --inference async or rtc: how long an inference takes [ms]; or measured, on this machine",
    )
    parser.add_argument(
        "--inference-correction",
        action="store_true",
        help="with --inference async or rtc: correct the running chunk in every frame for what is seen meanwhile",
    )
    parser.add_argument("--model", help="with --policy vlm: the model's name at the endpoint")
    parser.add_argument(
        "--prompt",
        default=DEFAULT_PROMPT.name,
        help=f"with --policy vlm: what the model is asked, {' or '.join(PROMPTS)}",
    )
    parser.add_argument(
        "--base-url",
        help="with --policy vlm: URL of an OpenAI-compatible endpoint; its key is read from OPENAI_API_KEY",
    )
    parser.add_argument(
        "--request-timeout",
        type=number(0.001, 86_400.0),
        default=60.0,
        help="with --policy vlm: time for a decision with all its requests [s]",
    )
    parser.add_argument(
        "--prices",
        type=number(0.0, 1e6),
        nargs=2,
        default=(0.0, 0.0),
        metavar=("PROMPT", "COMPLETION"),
        help="with --policy vlm: prices of a million tokens",
    )


def _latency(text: str) -> float | None:
    """Parse ``--inference-ms``; None is ``measured``."""
    return None if text == "measured" else number(0.0, MAX_LATENCY_MS)(text)
