"""What an evaluation was of, and what must be equal for it to be resumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynahoi_lerobot.sampling.benchmark import BENCHMARK

WEIGHTS = "weights"
"""Key of the sha256 of a policy's files of weights, by name."""


LONGEST_COMMAND = 4096


def command_line(words: Sequence[str]) -> str:
    """Return a command line as results keep it: printable, its program without the folder, cut where it is too long."""
    text = " ".join([Path(words[0]).name, *words[1:]])
    shown = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    return shown if len(shown) <= LONGEST_COMMAND else shown[: LONGEST_COMMAND - 4] + " ..."


@dataclass(frozen=True)
class RunInfo:
    """What was evaluated and how.

    Attributes:
        policy: the policy's name or path.
        split: the split that was played.
        capture: the capture rule, ``attach``, ``attach_lenient`` or ``contact``.
        command: the exact command line.
        fingerprint: identifies the code and recipe.
        extra: further JSON values: ``privileged`` if who moved the hand saw the simulator's state, ``inference`` and
            ``settings`` where inference took time or the policy's config was changed, ``recipe``, ``weights``, and
            whatever a figure needs, such as ``n_obs_frames`` or ``data_fraction``.
        benchmark: version of the benchmark.
    """

    policy: str
    split: str
    capture: str
    command: str
    fingerprint: str
    extra: dict[str, Any] = field(default_factory=dict)
    benchmark: str = BENCHMARK.version

    @property
    def conditions(self) -> dict[str, Any]:
        """What must be equal for an evaluation to be resumed, by a name for messages."""
        changed = {name: self.extra.get(name) or "none" for name in ("inference", "settings")}
        return {
            "policy": self.policy,
            "weights": self._weights,
            "split": self.split,
            "capture rule": self.capture,
            "recipe": self.fingerprint,
            "benchmark": self.benchmark,
        } | changed

    @property
    def _weights(self) -> str:
        digests = self.extra.get(WEIGHTS)
        if not isinstance(digests, dict) or not digests:
            return "none"
        return ", ".join(f"{name} {str(digest)[:12]}" for name, digest in digests.items())
