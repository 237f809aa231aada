"""The folder of a training run: its log, and what a killed run resumes from."""

import json
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from dynahoi_lerobot.core.files import write_atomically
from dynahoi_lerobot.core.reading import WEIGHTS_BYTES, read_text, reading, regular_zip
from dynahoi_lerobot.core.working_folder import working_folder

LOG, STATE = "log.jsonl", "state.pt"


class RunFolder:
    """Keeps log and saved state together: what was logged after the last save is dropped when a run resumes from it."""

    def __init__(self, path: Path, task: dict[str, Any]) -> None:
        """Claim a folder for ``task`` as long as this object lives; raises what ``working_folder`` raises."""
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
        import torch

        whole = state | {"log": read_text(self.path / LOG)}
        write_atomically({self.path / STATE: lambda path: torch.save(whole, path)})

    def restore(self) -> dict[str, Any] | None:
        """Return what was saved last, on the CPU, None for nothing, and let the log end there."""
        import torch

        if not (self.path / STATE).exists():
            (self.path / LOG).unlink(missing_ok=True)
            return None
        with reading(self.path / STATE):
            state = torch.load(regular_zip(self.path / STATE, WEIGHTS_BYTES), weights_only=True, map_location="cpu")
            log = str(state["log"])
        write_atomically({self.path / LOG: lambda path: path.write_text(log)})  # in place of a pipe or a link, too
        return state
