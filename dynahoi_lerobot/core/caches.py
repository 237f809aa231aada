"""Where libraries keep compiled code and downloads, on a machine that gives this user no home
folder to write to, or no name.
"""

import getpass
import os
import sys
import tempfile
from pathlib import Path

CACHES = {
    "WARP_CACHE_PATH": "warp",
    "MPLCONFIGDIR": "matplotlib",
    "HF_DATASETS_CACHE": "huggingface/datasets",
}
"""Folders below the user's caches that libraries must write to, by the variable that moves each."""
READ = "HF_HOME"
READ_IN = "huggingface"
"""Likewise, a folder that is of use also where it can only be read."""


def ensure_caches() -> None:
    """Let libraries keep their caches in a temporary folder where the home folder cannot be
    written, and say so on standard error, once for this process and its children.

    Variables that are set stay as they are. A user whom the system has no name for gets one, which
    torch asks for.
    """
    try:
        getpass.getuser()
    except (KeyError, OSError):  # of Python 3.12, and of 3.13
        os.environ["USER"] = str(os.getuid())
    usual = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.path.expanduser("~"), ".cache"))
    moved = {
        name: folder
        for name, folder in CACHES.items()
        if name not in os.environ and not _can_be_written(usual / folder)
    }
    if "HF_HOME" in os.environ:
        moved.pop("HF_DATASETS_CACHE", None)
    elif not (usual / READ_IN).is_dir() and not _can_be_written(usual / READ_IN):
        moved[READ] = READ_IN
    if not moved:
        return
    folder = _temporary()
    for name, part in moved.items():
        os.environ[name] = str(folder / part)
    print(f"{usual} cannot be written; caches go to {folder}", file=sys.stderr)


def _can_be_written(folder: Path) -> bool:
    """Tell whether a folder, or the nearest one above it that there is, can be written."""
    there = next((place for place in (folder, *folder.parents) if os.path.lexists(place)), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _temporary() -> Path:
    """Return a folder for caches that only this user can write, the same one each time if
    possible.
    """
    folder = Path(tempfile.gettempdir()) / f"dynahoi-caches-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if found.st_uid == os.getuid() and not folder.is_symlink() and not found.st_mode & 0o022:
            return folder
    except OSError:
        pass  # something else has its name
    return Path(tempfile.mkdtemp(prefix="dynahoi-caches-"))
