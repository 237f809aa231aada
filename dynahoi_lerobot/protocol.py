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
        has_screen: a panel hides the target from the hand's camera for 0.3 to 0.6 s before it can be met.
        meaning: a line for the command line's help.
    """

    name: str
    has_window: bool
    blind_control: bool
    has_screen: bool
    meaning: str


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol("observe_before_act", True, False, False, "an observation window, then control"),
        Protocol("direct_act", False, False, False, "control from the first frame on"),
        Protocol("observe_then_blind", True, True, False, "an observation window, then control with black images"),
        Protocol(
            "occluded", True, False, True, "an observation window, then control; a screen hides the target in between"
        ),
    )
}
"""Under ``observe_then_blind`` only a prediction from the window tells where to go, and under ``occluded`` one from
before the target vanishes."""

DEFAULT_PROTOCOL = "observe_before_act"


def protocol_of(name: str) -> Protocol:
    """Return the protocol called ``name``.

    Raises:
        ValueError: naming the protocol received and the ones there are.
    """
    if name not in PROTOCOLS:
        raise ValueError(f"unknown protocol {name!r}; known: {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]
