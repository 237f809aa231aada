"""What a package of somebody else's would hold: ``register`` adds a motion and an object from outside the core."""

from __future__ import annotations

import importlib


def register() -> None:
    """Register both, as importing such a package would."""
    importlib.import_module("tests.third_party.things")
