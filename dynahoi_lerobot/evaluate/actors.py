"""What commands that play have in common: who moves the hand, and under which rules."""

from collections.abc import Mapping, Sequence
from typing import Any

from dynahoi_lerobot.captures import CAPTURES
from dynahoi_lerobot.core.agent import Actor
from dynahoi_lerobot.core.escaping import printable
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.rules import Rules

VLM = "vlm"
"""Name of the vision-language model at an endpoint, which ``dynahoi evaluate`` sets up."""

AS_TRAINED = {Rules: "by default as the policy was trained"}
"""What is added to the help of the rules where a policy plays."""

TRUST = "load the checkpoint even if it can run code, and list the findings (docs/notes/trust.md)"
"""Help of ``--trust``, which every command that loads a policy has."""

EXPERT_ALIAS = "expert"
"""Name of the capture rule's own expert: ``intercept`` under attach, ``match`` under contact."""


def make_actor(
    name: str,
    capture: str = "attach",
    device: str | None = None,
    settings: Sequence[str] = (),
    *,
    trust: bool = False,
) -> Actor:
    """Return the expert called ``name``, or else load the policy of that name.

    Args:
        name: an expert; ``expert`` for the capture rule's own; or a policy, as ``PolicyAgent``
            takes it.
        capture: the capture rule, ``attach``, ``attach_lenient`` or ``contact``.
        device: torch device of a policy, its own if None.
        settings: changes of a policy's config, ``KEY=VALUE`` each.
        trust: load a policy even if that can run code of its own.

    Raises:
        ValueError: if there is no such policy, its config cannot be changed so, or loading it could
            run code of its own, unless ``trust`` allows that.
    """
    key = CAPTURES[capture].expert if name == EXPERT_ALIAS else name
    if settings and key in (*EXPERTS.names(), VLM):
        raise ValueError(f"--set changes the config of a LeRobot policy, and {name!r} has none")
    if key in EXPERTS:
        return EXPERTS[key]()
    return PolicyAgent(name, device, settings, trust=trust)


def playing_rules(given: Mapping[str, Any], actor: Actor) -> dict[str, Any]:
    """Return the values of fields of `Recipe` and `Rules` to play by: those ``given``, and what the
    actor was trained for, which is printed where it is not the default.
    """
    trained = {name: value for name, value in actor.trained_for.items() if name not in given}
    usual = Rules()
    told = [
        f"--{name.replace('_', '-')} {','.join(value) if isinstance(value, tuple) else value}"
        for name, value in trained.items()
        if value != getattr(usual, name)
    ]
    if told:
        print(printable(f"{actor.name} plays as it was trained: {', '.join(told)}"))
    views = tuple(dict.fromkeys((*given.get("views", ()), *actor.views)))
    return trained | dict(given) | {"views": views}
