"""Nothing installs our distributions from an index, or opens a Hub repository, under a name that is not registered."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
UNREAD = (".gif", ".jpg", ".png", ".npz", ".parquet", ".pem", ".safetensors")
DISTRIBUTION = r"(?:dynahoi(?:[-_]lerobot)?|lerobot[-_](?:env[-_]dynahoi|policy[-_](?:obact|actiontokens)))"
INSTALL = re.compile(
    rf"(?:pip install|uv add|uv tool install|uvx|pipx \w+)\b[^\n`#]*?(?<![\w./\\-]){DISTRIBUTION}(?![\w/.-])"
)
HUB_NAME = re.compile(r"(?<![\w./-])dynahoi/(?![\w<{].*?-v\d)[\w.-]*\w")
LOCAL = re.compile(r"repo[-_]id\b")


def foreign_names(text: str) -> list[str]:
    """Return the lines that install or open what is registered nowhere."""
    return [
        line.strip()
        for line in text.splitlines()
        if INSTALL.search(line) or (HUB_NAME.search(line) and not LOCAL.search(line))
    ]


def test_the_repository_names_nothing_that_is_not_registered():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    paths = [ROOT / name for name in listed if ROOT / name != Path(__file__) and not name.endswith(UNREAD)]
    assert len(paths) > 100
    found = {path.relative_to(ROOT).as_posix(): foreign_names(path.read_text()) for path in paths if path.is_file()}
    assert not {path: lines for path, lines in found.items() if lines}
