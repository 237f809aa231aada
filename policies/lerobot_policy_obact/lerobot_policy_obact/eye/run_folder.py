"""What a pretraining writes while it runs: a log, and a state from which it resumes."""

import json
import math
import weakref
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.reading import read_text, reading, regular
from dynahoi_lerobot.core.working_folder import working_folder

LOG = "log.jsonl"
STATE = "state.pt"
STATE_TYPES = {
    "updates": int,
    "processor_s": float,
    "weights": dict,
    "optimizer": dict,
    "log": str,
}
"""What a saved state holds."""


class RunFolder:
    """Keeps log and saved state together: what was logged after the last save is dropped when a run
    resumes from it.
    """

    def __init__(self, path: Path, task: dict[str, Any]) -> None:
        """Claim a folder for ``task`` as long as this object lives; raises what ``working_folder``
        raises.
        """
        self.path = path
        claim = ExitStack()
        claim.enter_context(working_folder(path, task))
        self.release = weakref.finalize(self, claim.close)

    def log(self, line: dict[str, Any]) -> None:
        """Append a line of JSON."""
        with (self.path / LOG).open("a") as file:
            file.write(json.dumps(line) + "\n")

    def save(self, state: dict[str, Any]) -> None:
        """Write what to go on from, whole or not at all, in place of what was saved before."""
        whole = state | {"log": read_text(self.path / LOG)}
        write_atomically({self.path / STATE: lambda path: torch.save(whole, path)})

    def restore(self) -> dict[str, Any] | None:
        """Return what was saved last, on the CPU, None for nothing, and let the log end there."""
        if not (self.path / STATE).exists():
            (self.path / LOG).unlink(missing_ok=True)
            return None
        with reading(self.path / STATE):
            state = torch.load(regular(self.path / STATE), weights_only=True, map_location="cpu")
            log = str(state["log"])
        # in place of a pipe or a link, too
        write_atomically({self.path / LOG: lambda path: path.write_text(log)})
        return state


def check_progress(state: dict[str, Any], n_updates: int) -> None:
    """Check that a saved state has all entries, and is of a run of ``n_updates``.

    Raises:
        TypeError: if it lacks an entry, or has one of another type.
        ValueError: if it is of no such run.
    """
    for name, kind in STATE_TYPES.items():
        if not isinstance(state.get(name), kind):
            raise TypeError(f"it has no {name!r} of type {kind.__name__}")
    done = state["updates"]
    spent_s = state["processor_s"]
    if not 1 <= done <= n_updates or not 0 <= spent_s < math.inf:
        raise ValueError(
            f"it says {done} updates in {spent_s} s; it must be 1 to {n_updates}, in 0 s or more"
        )


def check_moments(state: dict[str, Any], weights: Iterable[Tensor]) -> None:
    """Check that the optimizer of a saved state has moments for the ``weights`` loaded from it.

    Raises:
        ValueError: if a weight or one of its moments cannot be that of a run.
    """
    done = state["updates"]
    for place, weight in enumerate(weights):
        wanted = {"step": torch.tensor(float(done)), "exp_avg": weight, "exp_avg_sq": weight}
        held = state["optimizer"]["state"].get(place, {})
        wrong = [name for name in wanted if not _alike(held.get(name), wanted[name])]
        if wrong:
            raise ValueError(f"weight {place} or its {wrong[0]} is not that of {done} updates")


def _alike(saved: Any, wanted: Tensor) -> bool:
    """Tell whether what was saved is a tensor like the one that is wanted, the same if that is a
    number, and finite.
    """
    if not isinstance(saved, Tensor) or (saved.shape, saved.dtype) != (wanted.shape, wanted.dtype):
        return False
    return bool(saved.isfinite().all() and wanted.isfinite().all()) and (
        wanted.dim() > 0 or saved.equal(wanted)
    )
