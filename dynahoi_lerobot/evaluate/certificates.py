"""What this user has certified: a record outside of result folders, so that who made a folder cannot write it.

A certificate is of the exact bytes of the three files of a result folder: after any change they have none.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dynahoi_lerobot.evaluate.atomic import write_atomically
from dynahoi_lerobot.evaluate.result_files import ACTIONS_FILE, EPISODES_FILE, METRICS_FILE
from dynahoi_lerobot.foundation.digest import sha256

HOME = "DYNAHOI_HOME"
"""Environment variable that names the folder for what is kept between commands, ``~/.cache/dynahoi`` by default."""


@dataclass(frozen=True)
class Certificate:
    """What ``dynahoi certify`` confirmed.

    Attributes:
        episodes: in the results.
        replayed: how many of them were played again.
    """

    episodes: int
    replayed: int

    def __str__(self) -> str:
        """Return what a table shows."""
        return "all" if self.replayed == self.episodes else f"{self.replayed} of {self.episodes}"


def keep(folder: Path, certificate: Certificate) -> None:
    """Record that the results in ``folder`` were certified, unless more of them have been."""
    earlier = find(folder)
    if earlier is None or earlier.replayed < certificate.replayed:
        path = _path(folder)
        write_atomically({path: lambda file: file.write_text(json.dumps(asdict(certificate)) + "\n")})


def withdraw(folder: Path) -> None:
    """Forget that the results in ``folder`` were certified."""
    _path(folder).unlink(missing_ok=True)


def find(folder: Path) -> Certificate | None:
    """Return the certificate of the results in ``folder``; None if they have none that can be read."""
    try:
        content: Any = json.loads(_path(folder).read_text())
        return Certificate(int(content["episodes"]), int(content["replayed"]))
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _path(folder: Path) -> Path:
    home = os.environ.get(HOME) or Path.home() / ".cache" / "dynahoi"
    files = (sha256(folder / name) for name in (METRICS_FILE, EPISODES_FILE, ACTIONS_FILE))
    return Path(home) / "certificates" / f"{hashlib.sha256(' '.join(files).encode()).hexdigest()}.json"
