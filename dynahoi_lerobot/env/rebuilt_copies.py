"""Copies of an environment (``pickle``, ``deepcopy``): constructed anew from the same arguments."""

from __future__ import annotations

from typing import Any

OWN_OPTIONS = ("num_envs", "recipe", "kind", "render_mode", "reward")
"""Arguments that are attributes of the environment; ``threads`` and ``on_episode`` are private ones."""


class RebuiltCopies:
    """An environment whose copies begin before their first reset.

    Attributes:
        recipe: what it plays.
        spec: what gymnasium made it from.
    """

    recipe: Any
    spec: Any
    _threads: int
    _on_episode: Any

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy is made from: the constructor's arguments."""
        options = {name: getattr(self, name) for name in OWN_OPTIONS}
        options |= {"threads": self._threads, "on_episode": self._on_episode}
        return {"options": options, "spec": self.spec}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Construct the copy."""
        self.__init__(**state["options"])
        self.spec = state["spec"]
