"""Protocols: what the hand may see, and when."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Protocol:
    """What comes before the control phase, and what is seen in it.

    Attributes:
        name: its name in recipes and results.
        has_window: the hand is held still for an observation window first (Section 3 of the paper).
        blind_control: all images are black from the first control frame on; proprioception stays.
        meaning: a line for the command line's help.
    """

    name: str
    has_window: bool
    blind_control: bool
    meaning: str


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol("observe_before_act", True, False, "an observation window, then control"),
        Protocol("direct_act", False, False, "control from the first frame on"),
        Protocol("observe_then_blind", True, True, "an observation window, then control with black images"),
    )
}
"""Under ``observe_then_blind`` only a prediction from the window tells where to go."""

DEFAULT_PROTOCOL = "observe_before_act"


def protocol_of(name: str) -> Protocol:
    """Return the protocol called ``name``.

    Raises:
        ValueError: naming the protocol received and the ones there are.
    """
    if name not in PROTOCOLS:
        raise ValueError(f"unknown protocol {name!r}; known: {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]
