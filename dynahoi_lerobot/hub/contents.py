"""What is pushed: the folder, the type of its repository, and its tags."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import CARD_PATH, CODEBASE_VERSION, INFO_PATH, MANIFEST_PATH
from dynahoi_lerobot.evaluate.checkpoint import CONFIG, PICKLES, folder_weights
from dynahoi_lerobot.evaluate.result_files import ACTIONS_FILE, EPISODES_FILE, METRICS_FILE
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.hub.checkpoint_card import checkpoint_card
from dynahoi_lerobot.hub.eval_results import EVAL_RESULTS, eval_results_yaml, variant
from dynahoi_lerobot.hub.leaderboards import CARD_REPO, EVAL_FILE, why_unranked
from dynahoi_lerobot.hub.weights import evaluated, evaluated_weights
from dynahoi_lerobot.sampling.benchmark import BENCHMARK

ENV_FILE = "env.py"
"""What LeRobot's ``make_env("user/name")`` runs."""
RESULTS = "results"
"""Folder of a checkpoint's repository with the result folders, whose action logs ``dynahoi certify`` replays."""
RESULT_FOLDERS = (EVAL_RESULTS, RESULTS)
KIND_FILES = {
    "dataset": INFO_PATH,
    "results": METRICS_FILE,
    "checkpoint": CONFIG,
    "environment": ENV_FILE,
    "benchmark": EVAL_FILE,
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
        unranked: of results, why no leaderboard lists them; empty if one does.
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
    unranked: str = ""
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
        others=tuple(f"{name}/" for name in RESULT_FOLDERS), weights=folder_weights(folder),
        card="" if (folder / CARD_PATH).is_file() else checkpoint_card(folder, repo),
    )  # fmt: skip


def environment_contents(folder: Path) -> Contents:
    """Return an environment of LeRobot's EnvHub, which lies in a repository like a checkpoint's."""
    return Contents(folder, "model", ignored=("**/__pycache__/**", "__pycache__/**", ".cache/**"))


def benchmark_contents(folder: Path, stage: Path, repo: str) -> Contents:
    """Return the benchmark's dataset, as ``hub.benchmark_repo`` writes it, tagged with the benchmark's version.

    Its card names the repository, so a copy is made in ``stage``.
    """
    shutil.copytree(folder, stage, ignore=shutil.ignore_patterns(".cache"))
    if (card := stage / CARD_PATH).is_file():
        card.write_text(card.read_text(encoding="utf-8").replace(CARD_REPO, repo), encoding="utf-8")
    return Contents(stage, "dataset", tags=(f"dynahoi-{BENCHMARK.version}",), ignored=(".cache/**",))


def results_contents(folder: Path, stage: Path, repo: str, benchmark: str, endpoint: str) -> Contents:
    """Return a result folder for the checkpoint's repository and, if it is ranked, its evaluation results.

    Args:
        folder: what ``dynahoi evaluate`` wrote.
        stage: a new folder, in which they are laid out.
        repo: the checkpoint's repository.
        benchmark: the dataset's repository whose leaderboard lists them.
        endpoint: address of the Hub.

    Raises:
        ResultsError: if the folder is incomplete or damaged.
    """
    results = read_results(folder)
    name = variant(results)
    source = f"{endpoint}/{repo}/tree/main/{RESULTS}/{name}"
    if not (unranked := why_unranked(results)):
        (stage / EVAL_RESULTS).mkdir(parents=True)
        entries = eval_results_yaml(results, benchmark, source)
        (stage / EVAL_RESULTS / f"{name}.yaml").write_text(entries, encoding="utf-8")
    (stage / RESULTS / name).mkdir(parents=True)
    for file in (METRICS_FILE, EPISODES_FILE, ACTIONS_FILE):
        shutil.copyfile(folder / file, stage / RESULTS / name / file)
    return Contents(
        stage, "model", (CONFIG, "type"), adds_to=CONFIG, unranked=unranked, source=str(folder),
        policy=evaluated(results.info), weights=evaluated_weights(results.info),
    )  # fmt: skip


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
