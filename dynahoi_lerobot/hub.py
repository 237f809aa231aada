"""``dynahoi push``: upload a dataset, a checkpoint, results or an environment to the Hugging Face
Hub.

What is pushed is verified, loaded or replayed first, then uploaded, described on a card and tagged.
A repository is never mixed with other content. What stopped is resumed by the same command, because
the Hub's client sends only what the Hub lacks.
"""

from __future__ import annotations

import hashlib
import re
import secrets
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynahoi_lerobot.core.arguments import CommandError, argument, option
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.reading import read_object, reading
from dynahoi_lerobot.core.working_folder import resumable
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import CARD_PATH, CODEBASE_VERSION, INFO_PATH, MANIFEST_PATH
from dynahoi_lerobot.evaluate.actors import TRUST
from dynahoi_lerobot.evaluate.checkpoint import PLUGINS, checked_folder, load_policy
from dynahoi_lerobot.evaluate.checkpoint_files import (
    BASE,
    CONFIG,
    TRAINING,
    folder_weights,
    hint_at_checkpoint,
)
from dynahoi_lerobot.evaluate.checkpoint_rules import trained_for
from dynahoi_lerobot.evaluate.replay_results import (
    changed_rules,
    drawn,
    open_recipe,
    replay_problems,
)
from dynahoi_lerobot.evaluate.results import (
    ACTIONS_FILE,
    EPISODES_FILE,
    METRICS_FILE,
    WEIGHTS,
    Results,
    read_results,
)
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.fingerprint import recipe_code
from dynahoi_lerobot.sampling.salt import split_of
from dynahoi_lerobot.verify.command import verify

if TYPE_CHECKING:
    from huggingface_hub import HfApi, ModelCard

HUB_FILES = (CARD_PATH, "LICENSE", ".gitattributes")
"""Files that every repository may have, whoever wrote them."""
RESULTS = "results"
"""Folder of a checkpoint's repository with the result folders, for ``dynahoi evaluate
--replay``."""
IGNORED = [".cache/**", "training_state/**", "**/__pycache__/**", "__pycache__/**"]
NAME_LENGTH = 120
"""Characters of the longest name of a result folder; a longer one is cut and ends with digits of a
hash."""
REPLAYED = 8
"""Episodes of results that are replayed before they are pushed."""
SHOWN_METRICS = ("S_hold", "S_joint", "S_loc")
"""Metrics of results that a model card lists."""

RESUME = "nothing is lost; run the same command to resume"
LOG_IN = (
    "create one that can write at https://huggingface.co/settings/tokens, then run `hf auth "
    "login` or set HF_TOKEN"
)
ANSWERS = {
    401: f"the Hub rejected the token; {LOG_IN}",
    403: f"the token has no write access there; {LOG_IN}",
    413: "the Hub rejected it as too large",
    429: f"the Hub limits the rate of requests; wait a few minutes: {RESUME}",
}
"""By HTTP status."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of ``dynahoi push``."""

    folder: Path = argument("a dataset, a pretrained_model folder, a result folder or envs/hub")
    repo: str = argument("USER/NAME on the Hub; for results, the repository of their checkpoint")
    private: bool = option(False, "create a private repository")
    replace: bool = option(
        False, "checkpoints only: overwrite different weights and delete their results"
    )
    policy: str | None = option(None, "results only: name of the evaluated policy, if it differed")
    full: bool = option(False, f"results only: replay all episodes, not {REPLAYED} of them")
    trust: bool = option(False, TRUST)


def run(options: Options) -> int:
    """Push the folder and print its address; return the exit code."""
    kind = kind_of(options.folder)
    for name, owner in OWNERS.items():
        if getattr(options, name) and kind != owner:
            raise ValueError(
                f"--{name} is for a push of {owner}; {options.folder} holds this: {kind}"
            )
    for entry in options.folder.rglob("*"):
        if entry.is_symlink():
            raise ValueError(
                f"{entry} is a link, and its target is not uploaded; put a copy in its place"
            )
    push = KINDS[kind][1]
    try:
        repository = Repository.open(options.repo, "dataset" if kind == "dataset" else "model")
        with resumable():
            pushed = push(options, repository)
    except (CommandError, ValueError, ModuleNotFoundError):
        raise
    except Exception as error:  # whatever goes wrong on the Hub or on the way to it
        raise CommandError(f"{options.repo}: {reason(error)}") from error
    print(f"{kind} pushed to {pushed}")
    return 0


def kind_of(folder: Path) -> str:
    """Return the kind of a folder, a key of ``KINDS``; ValueError if it is of no kind."""
    for kind, (file, _) in KINDS.items():
        if (folder / file).exists():
            return kind
    known = ", ".join(f"{kind} ({file})" for kind, (file, _) in KINDS.items())
    raise ValueError(f"{folder} holds none of these: {known}{hint_at_checkpoint(folder)}")


@dataclass(frozen=True)
class Repository:
    """A repository ``user/name`` of a ``kind``, dataset or model, and the account that writes to
    it.
    """

    api: HfApi
    name: str
    kind: str

    @classmethod
    def open(cls, name: str, kind: str) -> Repository:
        """Log in with the token that ``hf auth login`` stored, or of ``HF_TOKEN``.

        Raises:
            CommandError: if there is no token.
            ValueError: if the name is none.
        """
        from huggingface_hub import HfApi, get_token

        if not re.fullmatch(r"[\w.-]+/[\w.-]+", name):
            raise ValueError(f"the repository is {name!r}; it must be USER/NAME")
        if not get_token():
            raise CommandError(f"no Hub token found; {LOG_IN}")
        api = HfApi()
        api.whoami()
        return cls(api, name, kind)

    @property
    def address(self) -> str:
        """Where it is found."""
        return f"{self.api.endpoint}/{'datasets/' if self.kind == 'dataset' else ''}{self.name}"

    def files(self) -> set[str]:
        """Return the paths of its files; none if it does not exist."""
        if not self.api.repo_exists(self.name, repo_type=self.kind):
            return set()
        return set(self.api.list_repo_files(self.name, repo_type=self.kind))

    def download(self, path: str) -> Path:
        """Return a local copy of one of its files."""
        return Path(self.api.hf_hub_download(self.name, path, repo_type=self.kind))

    def weights(self) -> dict[str, str]:
        """Return the sha256 of a model's large files, by path."""
        files = self.api.model_info(self.name, files_metadata=True).siblings or ()
        return {file.rfilename: file.lfs.sha256 for file in files if file.lfs}

    def claim(self, folder: Path, *, private: bool) -> set[str]:
        """Create it if absent, refuse it if it holds anything but an earlier push of ``folder``,
        and return its files.

        Raises:
            CommandError: if it holds other content, or is public where a private one is asked for.
        """
        self.api.create_repo(self.name, repo_type=self.kind, private=private or None, exist_ok=True)
        if private and not self.api.repo_info(self.name, repo_type=self.kind).private:
            raise CommandError(
                f"{self.name} exists and is public; make it private in its settings, or choose "
                f"another name"
            )
        files = self.files()
        own = {path.relative_to(folder).as_posix() for path in folder.rglob("*")}
        others = files - own.union(HUB_FILES)
        foreign = sorted(name for name in others if not name.startswith(f"{RESULTS}/"))
        if foreign:
            raise CommandError(
                f"{self.name} holds other content ({foreign[0]}); choose another name"
            )
        return files

    def upload(self, folder: Path, **options: Any) -> None:
        """Upload a folder; ``options`` go to ``HfApi.upload_folder``."""
        self.api.upload_folder(
            repo_id=self.name,
            folder_path=folder,
            repo_type=self.kind,
            ignore_patterns=IGNORED,
            commit_message=f"Push {folder.resolve().name} with dynahoi",
            **options,
        )

    def upload_card(self, card: ModelCard) -> None:
        """Replace the card; the client makes no commit if it says the same."""
        self.api.upload_file(
            repo_id=self.name,
            path_or_fileobj=str(card).encode(),
            path_in_repo=CARD_PATH,
            repo_type=self.kind,
            commit_message="Write the card with dynahoi",
        )

    def tag(self, tag: str) -> None:
        """Set a tag on the latest commit; one that exists is moved."""
        from huggingface_hub.errors import RevisionNotFoundError

        with suppress(RevisionNotFoundError):
            self.api.delete_tag(self.name, tag=tag, repo_type=self.kind)
        self.api.create_tag(self.name, tag=tag, repo_type=self.kind)


# -- datasets and environments ---------------------------------------------------------------------


def push_dataset(options: Options, repository: Repository) -> str:
    """Push a dataset that verifies, tagged with LeRobot's version, which its reader asks for, and
    the benchmark's.
    """
    findings = verify(options.folder)
    if findings:
        print(*findings, sep="\n", file=sys.stderr)
        raise CommandError(f"{options.folder} was not pushed: `dynahoi verify` has findings")
    manifest = Manifest.read(options.folder)
    files = repository.claim(options.folder, private=options.private)
    if MANIFEST_PATH in files:
        there = read_object(repository.download(MANIFEST_PATH))
        if there.get("sha256") != manifest.digest:
            raise CommandError(f"{repository.name} holds another dataset; choose another name")
    repository.upload(options.folder)
    benchmarks = [version for version in manifest.benchmark.split(", ") if version]
    tags = [CODEBASE_VERSION, *(f"dynahoi-{version}" for version in benchmarks)]
    for tag in tags:
        repository.tag(tag)
    return f"{repository.address}, tagged {', '.join(tags)}"


def push_environment(options: Options, repository: Repository) -> str:
    """Push an environment of LeRobot's EnvHub, which lies in a repository like a checkpoint's."""
    repository.claim(options.folder, private=options.private)
    repository.upload(options.folder)
    return repository.address


# -- checkpoints -----------------------------------------------------------------------------------


def push_checkpoint(options: Options, repository: Repository) -> str:
    """Push a checkpoint, with a card if it has none; over other weights only with ``--replace``.

    Raises:
        PolicyError: if our loader refuses it.
    """
    folder = options.folder
    load_policy(checked_folder(str(folder), trust=options.trust), "cpu", trust=options.trust)
    card = checkpoint_card(folder, repository.name)
    files = repository.claim(folder, private=options.private)
    there = repository.weights()
    here = folder_weights(folder)
    other = [name for name, digest in here.items() if there.get(name, digest) != digest]
    if other and not options.replace:
        raise CommandError(
            f"{repository.name} holds other weights ({other[0]}); choose another name, or add "
            f"--replace, which also removes the results of the old ones"
        )
    repository.upload(folder, delete_patterns=[f"{RESULTS}/*"] if other else None)
    if CARD_PATH not in files and not (folder / CARD_PATH).is_file():
        repository.upload_card(card)
    return repository.address


def checkpoint_card(folder: Path, repo: str) -> ModelCard:
    """Return the card of a ``pretrained_model`` folder.

    Raises:
        ReadError: if its config is no JSON object with a policy type.
    """
    from huggingface_hub import ModelCard, ModelCardData

    config = read_object(folder / CONFIG, {"type": str})
    kind = config["type"]
    dataset = _training_dataset(folder / TRAINING)
    data = ModelCardData(
        library_name="lerobot",
        license=str(config.get("license") or "apache-2.0"),
        pipeline_tag="robotics",
        tags=["lerobot", "robotics", "dynahoi", kind],
        datasets=[dataset] if "/" in dataset else None,
    )
    name = repo.rpartition("/")[2]
    plugin = f" ./policies/{PLUGINS[kind]}" if kind in PLUGINS else ""
    return ModelCard(f"""---
{data.to_yaml()}
---

# {name}

A `{kind}` policy of [LeRobot](https://github.com/huggingface/lerobot) for catching moving
objects with a dexterous hand. It was trained for {_rules_in_words(folder)}.

```bash
pip install ".[lerobot]" ./envs/lerobot_env_dynahoi{plugin}   # in a checkout of dynahoi-lerobot
dynahoi evaluate --policy {repo} --split test --out results/{name}
```
""")


def _training_dataset(file: Path) -> str:
    """Return the dataset that a ``train_config.json`` names; empty if it names none."""
    if not file.exists():
        return ""
    with reading(file):
        dataset = read_object(file).get("dataset") or {}
        return str(dataset.get("repo_id") or "")


def _rules_in_words(folder: Path) -> str:
    """Return the rules that a checkpoint was trained for, such as ``image_size `96` ``."""
    rules = {"control_mode": JOINTS} | trained_for(folder)
    told = []
    for name, value in sorted(rules.items()):
        words = ", ".join(value) if isinstance(value, tuple) else value
        if words != "":
            told.append(f"{name} `{words}`")
    return ", ".join(told)


# -- results ---------------------------------------------------------------------------------------


def push_results(options: Options, repository: Repository) -> str:
    """Push results into the repository of their checkpoint, under a name of their own, and list
    them on its card.

    Raises:
        CommandError: if the repository holds no checkpoint, or nothing shows that the results are
            of it.
        ReadError: if the folder is incomplete or damaged.
    """
    results = read_results(options.folder)
    name = variant(results)
    files = repository.files()
    if CONFIG not in files:
        raise CommandError(f"{repository.name} holds no checkpoint; push it before its results")
    _check_policy(results, repository, options.policy or "")
    doubt = _replayed(results, None if options.full else REPLAYED)
    repository.upload(
        options.folder,
        path_in_repo=f"{RESULTS}/{name}",
        allow_patterns=[METRICS_FILE, EPISODES_FILE, ACTIONS_FILE],
    )
    if CARD_PATH in files or doubt:
        card = _card_of(repository, files)
        card.text = _with_doubt(card.text, name, doubt)
        _list_results(card, repository.name, results, name)
        repository.upload_card(card)
    return repository.address


def _check_policy(results: Results, repository: Repository, said: str) -> None:
    """Refuse results of another policy than the repository's, unless the user ``said`` that it is
    the same.

    The repository of an adapter does not hold the weights of its base model.
    """
    policy = results.info.policy
    played = results.info.extra.get(WEIGHTS) or {}
    here = f"{repository.name}: {results.folder} is of {policy}"
    if said == policy:
        return
    if said:
        raise CommandError(f"{here}, not of {said}")
    weights = {name: digest for name, digest in played.items() if not name.startswith(BASE)}
    same = bool(weights) and weights.items() <= repository.weights().items()
    named = policy == repository.name and not played
    if not (same or named):
        raise CommandError(
            f"{here}, and nothing shows that this repository holds it; push that checkpoint, or "
            f"add --policy {policy} if it does"
        )


def _replayed(results: Results, count: int | None) -> str:
    """Replay ``count`` random episodes, all for None; return why that cannot show anything here,
    empty if it did.

    Raises:
        CommandError: if the replayed commands give other results.
    """
    if results.info.code != recipe_code(results.recipe()):
        return (
            "they are of another version of the code, other libraries or another kind of processor"
        )
    chosen = drawn(len(results.rows), count, secrets.randbits(32))
    findings = replay_problems(results, open_recipe(results), chosen)
    if findings:
        raise CommandError(
            f"{results.folder} was not pushed, because its commands lead to other results: "
            f"{findings[0]}"
        )
    return ""


def variant(results: Results) -> str:
    """Return a folder name for the conditions of an evaluation; others have another one.

    It says the rules, whatever of the recipe is not the benchmark's, and the number of episodes of
    a part of a split.

    Raises:
        ReadError: if the results do not name their recipe.
        ValueError: if there is no such split, capture rule or control class.
    """
    info = results.info
    control_class = results.conditions["control_class"]
    told: list[Any] = [info.benchmark, info.split, info.capture, control_class]
    told += [info.extra.get("inference") or "", info.extra.get("settings") or ""]
    for name, (value, _) in changed_rules(results).items():
        if name != "salt":
            told += [name, value]
    if len(results.rows) != BENCHMARK.splits[split_of(info.split)].size:
        told += [len(results.rows), "episodes"]
    name = re.sub(r"[^A-Za-z0-9.-]+", "_", "_".join(map(str, told))).strip("_.")
    if len(name) <= NAME_LENGTH:
        return name
    digest = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{name[: NAME_LENGTH - 9]}_{digest}"


def _card_of(repository: Repository, files: set[str]) -> ModelCard:
    """Return the card of a repository with these files; an empty one if there is none."""
    from huggingface_hub import ModelCard

    if CARD_PATH not in files:
        return ModelCard("---\n---\n")
    there = repository.download(CARD_PATH)
    with reading(Path(repository.name) / CARD_PATH):
        return ModelCard.load(there, ignore_metadata_errors=True)


def _with_doubt(text: str, name: str, doubt: str) -> str:
    """Return the text of a card that says in its first line why results were not replayed; none if
    they were.
    """
    mark = f"> The results `{name}` were not replayed before they were pushed:"
    rest = "\n".join(line for line in text.split("\n") if not line.startswith(mark)).strip()
    return f"{mark} {doubt}.\n\n{rest}\n" if doubt else f"{rest}\n"


def _list_results(card: ModelCard, repo: str, results: Results, name: str) -> None:
    """List the main metrics of results on a card, in the form that the Hub shows."""
    from huggingface_hub import EvalResult

    data: Any = card.data
    listed = [entry for entry in data.eval_results or [] if entry.dataset_name != name]
    for metric in SHOWN_METRICS:
        value = results.summary[metric].value
        if value is not None:
            entry = EvalResult(
                task_type="robotics",
                dataset_type="dynahoi",
                dataset_name=name,
                dataset_split=results.info.split,
                metric_type=metric,
                metric_value=round(value, 4),
            )
            listed.append(entry)
    data.eval_results = listed
    data.model_name = repo


# -- failures --------------------------------------------------------------------------------------


def reason(error: BaseException) -> str:
    """Say why an upload stopped: the Hub's answer or the broken connection, which the client's
    exception may name as its cause.
    """
    import httpx
    from huggingface_hub import constants
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled

    if isinstance(error, HfHubHTTPError):
        status = error.response.status_code
        said = error.server_message or "no reason"
        return ANSWERS.get(status, f"the Hub answered {status} ({said}); {RESUME}")
    if isinstance(error, httpx.TransportError | OfflineModeIsEnabled):
        return f"cannot reach {constants.ENDPOINT} ({type(error).__name__}); {RESUME}"
    cause = error.__cause__ or error.__context__
    if cause is not None:
        return reason(cause)
    return f"the upload failed ({type(error).__name__}: {error}); {RESUME}"


KINDS: dict[str, tuple[str, Callable[[Options, Repository], str]]] = {
    "dataset": (INFO_PATH, push_dataset),
    "results": (METRICS_FILE, push_results),
    "checkpoint": (CONFIG, push_checkpoint),
    "environment": ("env.py", push_environment),
}
"""What can be pushed: the file that identifies it, and the function that pushes it and returns its
address. LeRobot's ``make_env("user/name")`` runs ``env.py``."""
OWNERS = {
    "policy": "results",
    "full": "results",
    "replace": "checkpoint",
    "trust": "checkpoint",
}
"""Options for a push of one kind, by name."""
