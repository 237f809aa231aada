"""``meta/manifest.json``: hashes, seeds and provenance of a dataset, by which it is checked,
resumed and merged.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self, get_type_hints

from dynahoi_lerobot.core.reading import ReadError, read_object, require_schema, sha256
from dynahoi_lerobot.dataset.paths import CARD_PATH, MANIFEST_PATH, write_json

SCHEMA = 1
"""What the files that this project writes hold. A reader refuses another number. A column that may
be missing is added without changing it."""
NOT_OURS = (CARD_PATH, "LICENSE", ".gitattributes", MANIFEST_PATH)
NOT_OUR_FOLDERS = (".cache/", ".git/")
"""What the Hub, git and people put beside a dataset; the manifest lists everything else but
itself."""


ENCODED = "encoded"
"""Entry of the provenance of a dataset whose images `dynahoi encode` has replaced: by which sensor,
and the digest of the dataset that it was made from."""


@dataclass(frozen=True)
class Manifest:
    """Contents and provenance of a dataset.

    Attributes:
        episodes: number of episodes.
        frames: number of frames.
        files: sha256 of every other file, by its path below the root.
        seeds: every episode's seed, in the dataset's order.
        provenance: recording, seed, encoding and code fingerprint of the generation plan.
        yields: how many seeds were tried and how many were kept, missed or rejected; how many of
            those kept failed.
        benchmark: version of the benchmark that the episodes are of.
        sha256: what the file says ``digest`` is; empty for a manifest that was not read from a
            file.
    """

    episodes: int
    frames: int
    files: dict[str, str]
    seeds: list[int] = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    yields: dict[str, int] = field(default_factory=dict)
    benchmark: str = ""
    sha256: str = field(default="", compare=False)

    @property
    def rules(self) -> dict[str, Any]:
        """The values of the fields of `Rules` under which the episodes were played; empty if it
        does not say.
        """
        recording = self.provenance.get("recording") or {}
        return (recording.get("recipe") or {}).get("rules") or {}

    @property
    def digest(self) -> str:
        """The sha256 of all else it says, as canonical JSON: sorted keys, no spaces, ASCII.

        It stands for the whole dataset: every file's hash is in it.
        """
        content = {name: value for name, value in self._content().items() if name != "sha256"}
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()

    def write(self, root: Path) -> None:
        """Write it below ``root``, with its ``digest``."""
        write_json(self._content() | {"sha256": self.digest}, root / MANIFEST_PATH)

    @classmethod
    def read(cls, root: Path) -> Self:
        """Read it from below ``root``; ReadError if there is none, or it is not JSON of the
        schema.
        """
        path = root / MANIFEST_PATH
        if not path.exists():
            raise ReadError(
                f"{root} was written by another tool, such as lerobot-edit-dataset: "
                f"{MANIFEST_PATH} is missing; name a dataset that `dynahoi generate` wrote"
            )
        check_schema(root)
        types = get_type_hints(cls)
        content = read_object(path, types)
        del content["schema"]
        unknown = sorted(content.keys() - types.keys())
        if unknown:
            raise ReadError(f"{path} has an unknown key {unknown[0]!r:.40}")
        return cls(**content)

    def _content(self) -> dict[str, Any]:
        return {"schema": SCHEMA, **asdict(self)}


def check_schema(root: Path) -> None:
    """Refuse a dataset of another schema than the one that is read here; one without a manifest,
    which another tool has edited, passes.

    Raises:
        ReadError: naming the schema that was found and the one that is read.
    """
    path = root / MANIFEST_PATH
    if not path.exists():
        return
    require_schema(path, read_object(path), SCHEMA, "generate the dataset again with this version")


def file_problems(root: Path, manifest: Manifest) -> Iterator[str]:
    """Yield every file that is missing, has changed or is not in the manifest; every byte is
    read.
    """
    yield from structure_problems(root, manifest)
    yield from (
        f"{name} has changed: its sha256 is not the manifest's"
        for name in changed_files(root, manifest)
    )


def changed_files(root: Path, manifest: Manifest) -> list[str]:
    """Return the names of the files that are there with other content; every byte is read.

    The card may differ: people edit theirs, and LeRobot's ``push_to_hub`` writes its own.
    """
    own = [name for name in manifest.files if _is_inside(name) and name != CARD_PATH]
    there = [name for name in own if os.path.isfile(root / name)]
    return [name for name in there if sha256(root / name) != manifest.files[name]]


def has_own_card(root: Path, manifest: Manifest) -> bool:
    """Tell whether the card is the one that the manifest lists."""
    card = root / CARD_PATH
    return os.path.isfile(card) and sha256(card) == manifest.files.get(CARD_PATH)


def _is_inside(name: str) -> bool:
    return ".." not in Path(name).parts and not Path(name).is_absolute()


def structure_problems(root: Path, manifest: Manifest) -> Iterator[str]:
    """Yield whether the manifest has changed, and files that are missing or not in it, without
    reading them.
    """
    if manifest.sha256 != manifest.digest:
        said = manifest.sha256[:12]
        found = manifest.digest[:12]
        yield (
            f"{MANIFEST_PATH} has changed: the sha256 of its content is {found}..., it says "
            f"{said or 'nothing'}..."
        )
    for name in manifest.files:
        if not _is_inside(name):
            yield f"the manifest names {name!r}, outside the dataset"
        # which takes any name, however long
        elif name != CARD_PATH and not os.path.isfile(root / name):
            yield f"{name} is missing"
    yield from _strays(root, manifest)


def _strays(root: Path, manifest: Manifest) -> Iterator[str]:
    """Yield empty folders, and files that the manifest does not list."""
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if f"{name}/".startswith(NOT_OUR_FOLDERS):
            continue
        if path.is_dir():
            if not any(path.iterdir()):
                yield f"{name} is an empty folder"
        elif name not in manifest.files and name not in NOT_OURS:
            yield f"{name} is not in the manifest"


def hash_files(root: Path) -> dict[str, str]:
    """Return the sha256 of every file below ``root`` but the manifest."""
    names = (
        path.relative_to(root).as_posix() for path in sorted(root.rglob("*")) if path.is_file()
    )
    return {name: sha256(root / name) for name in names if name != MANIFEST_PATH}
