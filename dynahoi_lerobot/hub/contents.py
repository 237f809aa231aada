"""What is pushed: the folder, the type of its repository, and its tags."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import CARD_PATH, CODEBASE_VERSION, INFO_PATH, MANIFEST_PATH
from dynahoi_lerobot.evaluate.checkpoint import CONFIG, PICKLES, folder_weights
from dynahoi_lerobot.evaluate.replay_results import changed_rules
from dynahoi_lerobot.evaluate.result_files import ACTIONS_FILE, EPISODES_FILE, METRICS_FILE
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.hub.checkpoint_card import checkpoint_card
from dynahoi_lerobot.hub.weights import evaluated, evaluated_weights
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.splits import split_of

ENV_FILE = "env.py"
"""What LeRobot's ``make_env("user/name")`` runs."""
RESULTS = "results"
"""Folder of a checkpoint's repository with the result folders, for ``dynahoi evaluate --replay``."""
NAME_LENGTH, DIGITS = 120, 8
"""Characters of the longest name of a result folder; a longer one is cut and ends with digits of a hash."""
KIND_FILES = {
    "dataset": INFO_PATH,
    "results": METRICS_FILE,
    "checkpoint": CONFIG,
    "environment": ENV_FILE,
}
"""What can be pushed, and the file that identifies it."""
HUB_FILES = (CARD_PATH, "LICENSE", ".gitattributes")
"""Files that every repository may have, whoever wrote them."""


@dataclass(frozen=True)
class Contents:
    """A folder to be pushed.

    Attributes:
        folder: what is uploaded, as it is.
        repo_type: ``dataset`` or ``model``.
        identity: JSON file that tells this content from another one under the same file names, and its key for that;
            empty if there is no such other one.
        tags: set on the commit, moved if they exist.
        ignored: glob patterns of what stays here.
        others: folders of the repository that belong to this content, but come with other pushes.
        adds_to: file without which there is nothing in the repository to add to; empty for content of its own.
        weights: sha256 of the weights by file name: of a checkpoint its own, of results those of the policy that they
            are of, if it lies here.
        source: of results, their folder.
        policy: of results, the path or repository of the policy that they are of.
        card: text of the card that a repository without one gets; empty for none.
    """

    folder: Path
    repo_type: str
    identity: tuple[str, str] = ("", "")
    tags: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    adds_to: str = ""
    weights: Mapping[str, str] = field(default_factory=dict)
    source: str = ""
    policy: str = ""
    card: str = ""

    def files(self) -> set[str]:
        """Return the paths of all files in the folder."""
        return {path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*") if path.is_file()}

    def is_foreign(self, name: str, files: set[str]) -> bool:
        """Tell whether a file of the repository belongs to something else, given this folder's ``files``."""
        known = name in files or name in HUB_FILES or name.startswith(self.others)
        return not known and not self.adds_to

    def own_identity(self) -> object:
        """Return the value by which this content is told from others."""
        return read_identity(self.folder / self.identity[0], self.identity[1])


def read_identity(path: Path, key: str) -> object:
    """Return a value of a JSON file, None if the file or the value is not there."""
    try:
        return json.loads(path.read_text(encoding="utf-8")).get(key)
    except (OSError, ValueError, AttributeError):
        return None


def dataset_contents(root: Path) -> Contents:
    """Return a dataset, tagged with LeRobot's version, without which its reader refuses, and the benchmark's."""
    versions = Manifest.read(root).benchmark.split(", ")
    tags = (CODEBASE_VERSION, *(f"dynahoi-{version}" for version in versions if version))
    return Contents(root, "dataset", (MANIFEST_PATH, "sha256"), tags, ignored=(".cache/**",))


def checkpoint_contents(folder: Path, repo: str) -> Contents:
    """Return a policy checkpoint, with a card for its repository if it has none.

    Raises:
        ValueError: if it holds a pickle, which our loader refuses.
    """
    if pickles := sorted(path.name for path in folder.rglob("*") if path.suffix.lower() in PICKLES):
        raise ValueError(f"{folder} holds the pickle {pickles[0]}, which nobody should load; save it as safetensors")
    return Contents(
        folder, "model", (CONFIG, "type"), ignored=("training_state/**", ".cache/**"),
        others=(f"{RESULTS}/",), weights=folder_weights(folder),
        card="" if (folder / CARD_PATH).is_file() else checkpoint_card(folder, repo),
    )  # fmt: skip


def environment_contents(folder: Path) -> Contents:
    """Return an environment of LeRobot's EnvHub, which lies in a repository like a checkpoint's."""
    return Contents(folder, "model", ignored=("**/__pycache__/**", "__pycache__/**", ".cache/**"))


def results_contents(folder: Path, stage: Path) -> Contents:
    """Return a result folder for the checkpoint's repository, under a name of its own.

    Args:
        folder: what ``dynahoi evaluate`` wrote.
        stage: a new folder, in which it is laid out.

    Raises:
        ResultsError: if the folder is incomplete or damaged.
    """
    results = read_results(folder)
    place = stage / RESULTS / variant(results)
    place.mkdir(parents=True)
    for file in (METRICS_FILE, EPISODES_FILE, ACTIONS_FILE):
        shutil.copyfile(folder / file, place / file)
    return Contents(
        stage, "model", (CONFIG, "type"), adds_to=CONFIG, source=str(folder),
        policy=evaluated(results.info), weights=evaluated_weights(results.info),
    )  # fmt: skip


def variant(results: Results) -> str:
    """Return a folder name for the conditions of an evaluation; others have another one.

    It says the rules, whatever of the recipe is not the benchmark's, and the number of episodes of a part of a split.

    Raises:
        ResultsError: if the results do not say what was played.
        ValueError: if there is no such split, capture rule or control class.
    """
    info = results.info
    words = [info.benchmark, info.split, info.capture, results.control_class]
    words += [_text(info.extra[name]) for name in ("inference", "settings") if info.extra.get(name)]
    words += [f"{name}_{_text(value)}" for name, (value, _) in changed_rules(results).items() if name != "salt"]
    text = "_".join([*words, *_part(results)])
    name = re.sub(r"[^A-Za-z0-9.-]+", "_", text).strip("_.")
    return name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - DIGITS - 1]}_{_digest(text)}"


def _part(results: Results) -> list[str]:
    """Return how many episodes were played and, if they are not the first ones, which; nothing for a whole split."""
    seeds = sorted(row["seed"] for row in results.rows)
    if len(seeds) == BENCHMARK.splits[split_of(results.info.split)].size:
        return []
    first = seeds == list(range(len(seeds)))
    return [f"{len(seeds)}_episodes", *([] if first else [_digest(str(seeds))])]


def _text(value: Any) -> str:
    return "_".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def kind_of(folder: Path) -> str:
    """Return what a folder holds: a key of ``KIND_FILES``.

    Raises:
        ValueError: if it is none of them.
    """
    for kind, file in KIND_FILES.items():
        if (folder / file).is_file():
            return kind
    nested = sorted(folder.glob(f"**/pretrained_model/{CONFIG}"))
    hint = f"; did you mean {nested[-1].parent}?" if nested else ""
    known = ", ".join(f"{kind} ({file})" for kind, file in KIND_FILES.items())
    raise ValueError(f"{folder} holds none of these: {known}{hint}")
