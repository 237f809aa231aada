"""The arguments of commands that play: who moves the hand, and under which rules."""

import argparse
from collections.abc import Sequence
from typing import Any

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.agent import Actor
from dynahoi_lerobot.core.arguments import add_field_arguments, number, path, whole
from dynahoi_lerobot.core.features import TRUTH
from dynahoi_lerobot.core.files import printable
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rollout.inference import INFERENCE_MODES, MAX_LATENCY_MS, SYNC
from dynahoi_lerobot.sampling.recipe import PLAYING, Recipe
from dynahoi_lerobot.sampling.splits import SMALL_TEST
from dynahoi_lerobot.vlm.prompt import DEFAULT_PROMPT, PROMPTS

VLM = "vlm"
"""Name of the vision-language model at an endpoint, which ``dynahoi evaluate`` sets up."""

TRAINED_FOR = ("control_class", "protocol", "control_mode", "image_size")
"""Fields of a recipe that a policy may say it was trained for."""

EXPERT_ALIAS = "expert"
"""Name of the capture rule's own expert: ``intercept`` under attach, ``match`` under contact."""

RECIPE_OPTIONS = tuple(name for name in PLAYING if name not in ("split", "views"))
"""Fields of the recipe that are options of the command; the policy decides the views."""


def make_actor(
    name: str, capture: str = "attach", device: str | None = None, settings: Sequence[str] = (), *, trust: bool = False
) -> Actor:
    """Return the expert called ``name``, or else load the policy of that name, and seed the noise that it samples from.

    Args:
        name: an expert; ``expert`` for the capture rule's own; or a policy, as ``PolicyAgent`` takes it.
        capture: the capture rule, ``attach``, ``attach_lenient`` or ``contact``.
        device: torch device of a policy, its own if None.
        settings: changes of a policy's config, ``KEY=VALUE`` each.
        trust: load a policy even if that can run code of its own.

    Raises:
        ValueError: if there is no such policy, its config cannot be changed so, or loading it could run code of its
            own, unless ``trust`` allows that.
    """
    key = CAPTURES[capture].expert if name == EXPERT_ALIAS else name
    if settings and key in (*EXPERTS.names(), VLM):
        raise ValueError(f"--set changes the config of a LeRobot policy, and {name!r} has none")
    if key in EXPERTS:
        return EXPERTS[key]()
    policy = PolicyAgent(name, device, settings, trust=trust)
    import torch  # which experts do without

    torch.manual_seed(0)
    return policy


def add_trust_argument(parser: argparse.ArgumentParser) -> None:
    """Declare ``--trust``, which every command that loads a policy has."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="load the checkpoint even if it can run code, and list the findings (docs/notes/trust.md)",
    )


def playing_rules(given: dict[str, Any], actor: Actor) -> dict[str, Any]:
    """Return fields of the recipe to play by: those ``given``, and what the actor was trained for, which is printed."""
    trained = {name: value for name, value in actor.trained_for.items() if name not in given}
    if trained:
        told = ", ".join(f"--{name.replace('_', '-')} {value}" for name, value in trained.items())
        print(f"{actor.name} plays as it was trained: {printable(told)}")
    return trained | given


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``dynahoi evaluate``."""
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument(
        "--replay",
        type=path,
        metavar="RESULTS",
        help="re-execute the commands of a result folder and compare all numbers",
    )
    task.add_argument(
        "--policy",
        help=f"checkpoint folder, Hub repository, vlm, or a privileged baseline: expert, {', '.join(EXPERTS.names())}",
    )
    parser.add_argument("--split", default=SMALL_TEST, help="test, test_small, val, twins or one of the ood_ splits")
    parser.add_argument("--out", type=path, help="result folder; an incomplete one is resumed")
    parser.add_argument(
        "--episodes",
        type=int,
        help="number of episodes: the first of the split, or random ones with --replay; all by default",
    )
    parser.add_argument(
        "--replay-seed",
        type=whole(0, 2**32 - 1),
        help="with --replay: seed of the draw, as printed by an earlier replay",
    )
    notes = dict.fromkeys(TRAINED_FOR, "by default the setting that the policy was trained with")
    notes |= {"environment_state": f"by default what the policy reads; {TRUTH} must be given, and makes it privileged"}
    add_field_arguments(parser, Recipe, RECIPE_OPTIONS, **notes)
    parser.add_argument(
        "--batch-size",
        type=whole(1, 4096),
        default=32,
        help="worlds simulated in parallel, without effect on results; 1 for policies with --inference-ms measured",
    )
    parser.add_argument("--gifs", type=whole(0, 10**6), default=0, help="number of episodes to record as GIFs in --out")
    parser.add_argument("--per-kind", action="store_true", help="also print a row for each kind of motion")
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
        help="override a field of the policy's config, such as n_action_steps=2; dictionaries as JSON; may be repeated",
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
        help="with --inference async or rtc: inference time [ms], or measured for the time on this machine",
    )
    parser.add_argument("--model", help="with --policy vlm: model name at the endpoint")
    parser.add_argument("--prompt", default=DEFAULT_PROMPT, help=f"with --policy vlm: prompt, {' or '.join(PROMPTS)}")
    parser.add_argument(
        "--base-url",
        help="with --policy vlm: URL of an OpenAI-compatible endpoint; its key is read from OPENAI_API_KEY",
    )
    parser.add_argument(
        "--request-timeout",
        type=number(0.001, 86_400.0),
        default=60.0,
        help="with --policy vlm: time limit of a decision with all its requests [s]",
    )


def _latency(text: str) -> float | None:
    """Parse ``--inference-ms``; None is ``measured``."""
    return None if text == "measured" else number(0.0, MAX_LATENCY_MS)(text)
