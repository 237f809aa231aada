"""``dynahoi push``: upload a dataset, a checkpoint, results or an environment to the Hugging Face
Hub.

A repository is never mixed with other content. What stopped is resumed by the same command, because
the Hub's client sends only what the Hub lacks.
"""

from __future__ import annotations

import hashlib
import re
import secrets
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from dynahoi_lerobot.core.arguments import CommandError, argument, option
from dynahoi_lerobot.core.control_mode import JOINTS
from dynahoi_lerobot.core.reading import GIB, read_object, read_text, reading, regular
from dynahoi_lerobot.dataset.card import markdown_template
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.paths import CARD_PATH, CODEBASE_VERSION, INFO_PATH, MANIFEST_PATH
from dynahoi_lerobot.evaluate.arguments import TRUST
from dynahoi_lerobot.evaluate.checkpoint import (
    BASE,
    CONFIG,
    PLUGINS,
    TRAINING,
    checked_folder,
    folder_weights,
    hint_at_checkpoint,
    load_policy,
    trained_for,
)  # fmt: skip
from dynahoi_lerobot.evaluate.replay_results import (
    changed_rules,
    check_episodes,
    check_results,
    drawn,
    open_recipe,
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

KIND_FILES = {
    "dataset": INFO_PATH,
    "results": METRICS_FILE,
    "checkpoint": CONFIG,
    "environment": "env.py",
}
"""What can be pushed, and the file that identifies it; LeRobot's ``make_env("user/name")`` runs
``env.py``."""
HUB_FILES = (CARD_PATH, "LICENSE", ".gitattributes")
"""Files that every repository may have, whoever wrote them."""
RESULTS = "results"
"""Folder of a checkpoint's repository with the result folders, for ``dynahoi evaluate
--replay``."""
IGNORED = [".cache/**", "training_state/**", "**/__pycache__/**", "__pycache__/**"]
NAME_LENGTH = 120
"""Characters of the longest name of a result folder; a longer one is cut and ends with digits of a
hash."""
KIND_OPTIONS = {
    "policy": "results",
    "full": "results",
    "replace": "checkpoint",
    "trust": "checkpoint",
}
"""Options that are for a push of one kind."""
REPLAYED = 8
"""Episodes of results that are replayed before they are pushed."""
LARGEST_FILE = 50 * GIB
"""Largest file that the Hub takes."""
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
    for name, wanted in KIND_OPTIONS.items():
        if getattr(options, name) and kind != wanted:
            raise ValueError(
                f"--{name} is for a push of {wanted}; {options.folder} holds this: {kind}"
            )
    for entry in options.folder.rglob("*"):
        if entry.is_symlink():
            raise ValueError(
                f"{entry} is a link, and what it leads to is not uploaded; put a copy in its place"
            )
        with reading(options.folder):
            str(entry).encode()  # the Hub's client cannot send other names
        if (
            entry.name in (CARD_PATH, ".gitignore") and not entry.is_dir()
        ):  # which the client reads whole
            read_text(entry)
        elif not entry.is_dir():
            regular(entry, LARGEST_FILE)
    try:
        pushed = PUSHES[kind](
            options, Repository.open(options.repo, "dataset" if kind == "dataset" else "model")
        )
    except (CommandError, ValueError, ModuleNotFoundError):
        raise
    except Exception as error:  # whatever goes wrong on the Hub or on the way to it
        raise CommandError(f"{options.repo}: {_sentence(error)}") from error
    print(f"{kind} pushed to {pushed}")
    return 0


def kind_of(folder: Path) -> str:
    """Return what a folder holds: a key of ``KIND_FILES``; ValueError if it is none of them."""
    for kind, file in KIND_FILES.items():
        if (folder / file).exists():
            return kind
    known = ", ".join(f"{kind} ({file})" for kind, file in KIND_FILES.items())
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
        held = set(self.api.list_repo_files(self.name, repo_type=self.kind))
        ours = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        if foreign := sorted(
            name for name in held - ours - set(HUB_FILES) if not name.startswith(f"{RESULTS}/")
        ):
            raise CommandError(
                f"{self.name} holds other content ({foreign[0]}); choose another name"
            )
        return held

    def upload(self, folder: Path, **options: Any) -> None:
        """Upload a folder; ``options`` go to ``HfApi.upload_folder``."""
        self.api.upload_folder(
            repo_id=self.name, folder_path=folder, repo_type=self.kind, ignore_patterns=IGNORED,
            commit_message=f"Push {folder.resolve().name} with dynahoi", **options,
        )  # fmt: skip

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


def push_dataset(options: Options, repository: Repository) -> str:
    """Push a dataset that verifies, tagged with LeRobot's version, which its reader asks for, and
    the benchmark's.
    """
    if findings := verify(options.folder):
        print(*findings, sep="\n", file=sys.stderr)
        raise CommandError(f"{options.folder} was not pushed: `dynahoi verify` has findings")
    manifest = Manifest.read(options.folder)
    if MANIFEST_PATH in repository.claim(options.folder, private=options.private):
        there = repository.api.hf_hub_download(
            repository.name, MANIFEST_PATH, repo_type=repository.kind
        )
        if read_object(Path(there)).get("sha256") != manifest.digest:
            raise CommandError(f"{repository.name} holds another dataset; choose another name")
    repository.upload(options.folder)
    versions = manifest.benchmark.split(", ")
    tags = [CODEBASE_VERSION, *(f"dynahoi-{version}" for version in versions if version)]
    for tag in tags:
        repository.tag(tag)
    return f"{repository.address}, tagged {', '.join(tags)}"


def push_checkpoint(options: Options, repository: Repository) -> str:
    """Push a checkpoint, with a card if it has none; over other weights only with ``--replace``.

    Raises:
        PolicyError: if our loader refuses it.
    """
    folder = options.folder
    load_policy(checked_folder(str(folder), trust=options.trust), "cpu", trust=options.trust)
    card = checkpoint_card(folder, repository.name)
    held = repository.claim(folder, private=options.private)
    there = repository.weights()
    other = [
        name for name, sha256 in folder_weights(folder).items() if there.get(name, sha256) != sha256
    ]
    if other and not options.replace:
        raise CommandError(
            f"{repository.name} holds other weights ({other[0]}); choose another name, or add "
            f"--replace, which "
            "also removes the results of the old ones"
        )
    repository.upload(folder, delete_patterns=[f"{RESULTS}/*"] if other else None)
    if CARD_PATH not in held and not (folder / CARD_PATH).is_file():
        repository.upload_card(card)
    return repository.address


def push_results(options: Options, repository: Repository) -> str:
    """Push results into the repository of their checkpoint, under a name of their own, and list
    them on its card.

    Raises:
        CommandError: if the repository holds no checkpoint, or nothing shows that the results are
            of it.
        ReadError: if the folder is incomplete or damaged.
    """
    from huggingface_hub import ModelCard

    results = read_results(options.folder)
    name, played = variant(results), [METRICS_FILE, EPISODES_FILE, ACTIONS_FILE]
    api = repository.api
    held = api.list_repo_files(repository.name) if api.repo_exists(repository.name) else []
    if CONFIG not in held:
        raise CommandError(f"{repository.name} holds no checkpoint; push it before its results")
    _check_policy(results, repository, options.policy or "")
    doubt = _replayed(results, None if options.full else REPLAYED)
    repository.upload(options.folder, path_in_repo=f"{RESULTS}/{name}", allow_patterns=played)
    if CARD_PATH in held or doubt:
        there = api.hf_hub_download(repository.name, CARD_PATH) if CARD_PATH in held else None
        with reading(Path(repository.name) / CARD_PATH):
            card = (
                ModelCard.load(there, ignore_metadata_errors=True)
                if there
                else ModelCard("---\n---\n")
            )
        card.text = _with_doubt(card.text, name, doubt)
        repository.upload_card(with_results(card, repository.name, results, name))
    return repository.address


def _replayed(results: Results, count: int | None) -> str:
    """Replay ``count`` random episodes, all for None; return why that cannot show anything here,
    empty if it did.

    Raises:
        CommandError: if the results are not those of their commands.
    """
    if results.info.code != recipe_code(results.recipe()):
        return (
            "they are of another version of the code, other libraries or another kind of processor"
        )
    chosen = drawn(len(results.rows), count, secrets.randbits(32))
    recipe = open_recipe(results)
    episodes = (finding for found in check_episodes(results, recipe, chosen) for finding in found)
    if finding := next(chain(check_results(results, recipe), episodes), None):
        raise CommandError(
            f"{results.folder} was not pushed, because its commands lead to other results: "
            f"{finding}"
        )
    return ""


def _with_doubt(text: str, name: str, doubt: str) -> str:
    """Return the text of a card that says in its first line why results were not replayed; none if
    they were.
    """
    mark = f"> The results `{name}` were not replayed before they were pushed:"
    rest = "\n".join(line for line in text.split("\n") if not line.startswith(mark)).strip()
    return f"{mark} {doubt}.\n\n{rest}\n" if doubt else f"{rest}\n"


def push_environment(options: Options, repository: Repository) -> str:
    """Push an environment of LeRobot's EnvHub, which lies in a repository like a checkpoint's."""
    repository.claim(options.folder, private=options.private)
    repository.upload(options.folder)
    return repository.address


PUSHES: dict[str, Callable[[Options, Repository], str]] = {
    "dataset": push_dataset,
    "checkpoint": push_checkpoint,
    "results": push_results,
    "environment": push_environment,
}


def _check_policy(results: Results, repository: Repository, said: str) -> None:
    """Refuse results of another policy than the repository's, unless the user ``said`` that it is
    the same.

    The repository of an adapter does not hold the weights of its base model.
    """
    policy, played = results.info.policy, results.info.extra.get(WEIGHTS) or {}
    weights = {name: digest for name, digest in played.items() if not name.startswith(BASE)}
    here = f"{repository.name}: {results.folder} is of {policy}"
    if said and said != policy:
        raise CommandError(f"{here}, not of {said}")
    there = repository.weights()
    same = bool(weights) and all(there.get(name) == sha256 for name, sha256 in weights.items())
    if not (said or same or (policy == repository.name and not played)):
        raise CommandError(
            f"{here}, and nothing shows that this repository holds it; push that checkpoint, or "
            f"add --policy {policy} "
            "if it does"
        )


def variant(results: Results) -> str:
    """Return a folder name for the conditions of an evaluation; others have another one.

    It says the rules, whatever of the recipe is not the benchmark's, and the number of episodes of
    a part of a split.

    Raises:
        ReadError: if the results do not say what was played.
        ValueError: if there is no such split, capture rule or control class.
    """
    info = results.info
    words = [info.benchmark, info.split, info.capture, results.conditions["control_class"]]
    words += [_text(info.extra[name]) for name in ("inference", "settings") if info.extra.get(name)]
    words += [
        f"{name}_{_text(value)}"
        for name, (value, _) in changed_rules(results).items()
        if name != "salt"
    ]
    if len(results.rows) != BENCHMARK.splits[split_of(info.split)].size:
        words.append(f"{len(results.rows)}_episodes")
    name = re.sub(r"[^A-Za-z0-9.-]+", "_", "_".join(words)).strip("_.")
    digest = hashlib.sha256(name.encode()).hexdigest()[:8]
    return name if len(name) <= NAME_LENGTH else f"{name[: NAME_LENGTH - 9]}_{digest}"


CARD = """
# {{ name }}

A `{{ type }}` policy of [LeRobot](https://github.com/huggingface/lerobot) for catching moving
objects with a dexterous hand.
{%- if rules %} It was trained for
{%- for key, value in rules.items() %} {{ key }} `{{ value }}`{{ "." if loop.last else "," }}
{%- endfor %}{% endif %}

```bash
pip install ".[lerobot]" ./envs/lerobot_env_dynahoi{{ needed }}   # in a checkout of dynahoi-lerobot
dynahoi evaluate --policy {{ repo }} --split test --out results/{{ name }}
```
"""


def checkpoint_card(folder: Path, repo: str) -> ModelCard:
    """Return the card of a ``pretrained_model`` folder.

    Raises:
        ReadError: if its config is no JSON object with a policy type.
    """
    from huggingface_hub import ModelCard, ModelCardData

    config = read_object(folder / CONFIG, {"type": str})
    kind, training = config["type"], folder / TRAINING
    with reading(training):
        told = read_object(training) if training.exists() else {}
        dataset = str((told.get("dataset") or {}).get("repo_id") or "")
    needed = Markup(f" ./policies/{PLUGINS[kind]}" if kind in PLUGINS else "")
    data = ModelCardData(
        library_name="lerobot", license=str(config.get("license") or "apache-2.0"),
        pipeline_tag="robotics", tags=["lerobot", "robotics", "dynahoi", kind],
        datasets=[dataset] if "/" in dataset else None,
    )  # fmt: skip
    trained = {"control_mode": JOINTS} | trained_for(folder)
    told = {
        name: ", ".join(value) if isinstance(value, tuple) else value
        for name, value in trained.items()
        if value not in ("", ())
    }
    body = markdown_template(CARD).render(
        name=repo.rpartition("/")[2],
        type=kind,
        repo=repo,
        needed=needed,
        rules=dict(sorted(told.items())),
    )
    return ModelCard(f"---\n{data.to_yaml()}\n---\n{body}")


def with_results(card: ModelCard, repo: str, results: Results, name: str) -> ModelCard:
    """Return a card that lists the main metrics of results, in the form that the Hub shows."""
    from huggingface_hub import EvalResult

    data: Any = card.data
    held = [entry for entry in data.eval_results or [] if entry.dataset_name != name]
    held += [
        EvalResult(
            task_type="robotics",
            dataset_type="dynahoi",
            dataset_name=name,
            dataset_split=results.info.split,
            metric_type=metric,
            metric_value=round(value, 4),
        )
        for metric in SHOWN_METRICS
        if (value := results.summary[metric].value) is not None
    ]
    data.eval_results, data.model_name = held, repo
    return card


def _sentence(error: BaseException) -> str:
    """Say what stopped an upload: the client names the Hub's answer, or the broken connection, as a
    cause.
    """
    import httpx
    from huggingface_hub import constants
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled

    if isinstance(error, HfHubHTTPError):
        status, said = error.response.status_code, error.server_message or "no reason"
        return ANSWERS.get(status, f"the Hub answered {status} ({said}); {RESUME}")
    if isinstance(error, httpx.TransportError | OfflineModeIsEnabled):
        return f"cannot reach {constants.ENDPOINT} ({type(error).__name__}); {RESUME}"
    if cause := error.__cause__ or error.__context__:
        return _sentence(cause)
    return f"the upload failed ({type(error).__name__}: {error}); {RESUME}"


def _text(value: Any) -> str:
    return (
        "_".join(map(str, value))
        if isinstance(value, Sequence) and not isinstance(value, str)
        else str(value)
    )
