"""A repository on the Hub: created if absent, never mixed with other content."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dynahoi_lerobot.dataset.paths import CARD_PATH
from dynahoi_lerobot.hub.contents import RESULTS, Contents, read_identity
from dynahoi_lerobot.hub.failures import LOG_IN, HubError, explained
from dynahoi_lerobot.hub.weights import other_weights, repository_weights

if TYPE_CHECKING:
    from huggingface_hub import HfApi


@dataclass(frozen=True)
class Repository:
    """A repository and the account that writes to it.

    Attributes:
        api: the Hub's client.
        name: ``user/name``.
        token: what the account is known by.
    """

    api: HfApi
    name: str
    token: str

    @classmethod
    def open(cls, name: str) -> Repository:
        """Log in with the token that ``hf auth login`` stored, or of ``HF_TOKEN``.

        Raises:
            HubError: if there is no token, the Hub refuses it or cannot be reached.
            ValueError: if the name is none.
        """
        from huggingface_hub import HfApi, get_token
        from huggingface_hub.utils import HFValidationError, validate_repo_id

        try:
            validate_repo_id(name)
        except HFValidationError as error:
            raise ValueError(f"the repository is {name!r}; it must be USER/NAME: {error}") from None
        if name.count("/") != 1:
            raise ValueError(f"the repository is {name!r}; it must be USER/NAME")
        if not (token := get_token()):
            raise HubError(f"no Hub token found; {LOG_IN}")
        repository = cls(HfApi(token=token), name, token)
        with explained(name, repository.api.endpoint, token):
            repository.api.whoami()
        return repository

    def push(self, contents: Contents, private: bool, *, replace: bool = False, policy: str = "") -> str:
        """Upload what is missing, set the tags and return the address.

        Args:
            contents: what is pushed.
            private: make a private repository.
            replace: put a checkpoint in the place of other weights, whose results are removed.
            policy: of results, what the user says that the repository holds under another name; empty for nothing.

        Raises:
            HubError: if the repository holds other content, other weights or another policy than results are of, or is
                public where a private one is asked for, or the upload stopped.
        """
        with explained(self.name, self.api.endpoint, self.token):
            self._make(contents, private)
            held = self._refuse_foreign(contents)
            renewed = self._check_weights(contents, replace, policy)
            self._upload(contents, renewed)
            if contents.card and CARD_PATH not in held:
                self._add_card(contents)
            for tag in contents.tags:
                self._tag(contents, tag)
        kind = "datasets/" if contents.repo_type == "dataset" else ""
        return f"{self.api.endpoint}/{kind}{self.name}"

    def _make(self, contents: Contents, private: bool) -> None:
        if not contents.adds_to:
            kind = contents.repo_type
            self.api.create_repo(self.name, repo_type=kind, private=private or None, exist_ok=True)
        elif not self.api.repo_exists(self.name, repo_type=contents.repo_type):
            raise HubError(f"{self.name}: the Hub has no such checkpoint; push it before its results")
        if private and not self.api.repo_info(self.name, repo_type=contents.repo_type).private:
            raise HubError(f"{self.name} exists and is public; make it private in its settings, or choose another name")

    def _refuse_foreign(self, contents: Contents) -> set[str]:
        """Refuse a repository that holds anything but an earlier push of the same content; return its files."""
        held = set(self.api.list_repo_files(self.name, repo_type=contents.repo_type))
        if contents.adds_to and contents.adds_to not in held:
            raise HubError(f"{self.name} holds no {contents.adds_to}; push the checkpoint before its results")
        ours = contents.files()
        if foreign := sorted(name for name in held if contents.is_foreign(name, ours)):
            raise HubError(f"{self.name} holds other content ({foreign[0]}); choose another name")
        file, key = contents.identity
        if file in held & ours:
            path = self.api.hf_hub_download(self.name, file, repo_type=contents.repo_type)
            if (found := read_identity(Path(path), key)) != (wanted := contents.own_identity()):
                raise HubError(
                    f"{self.name} holds other content (the {key} in {file} is {found}, not {wanted}); "
                    "choose another name"
                )
        return held

    def _check_weights(self, contents: Contents, replace: bool, policy: str) -> bool:
        """Refuse other weights than the repository's as ``push`` says; return whether a checkpoint replaces them."""
        other = self._other_weights(contents)
        if contents.adds_to:
            self._refuse_results_of_another(contents, other, policy)
            return False
        if other and not replace:
            raise HubError(
                f"{self.name} holds other weights ({other[0]}); choose another name, or add --replace, which also "
                "removes the results of the old ones"
            )
        return bool(other)

    def _other_weights(self, contents: Contents) -> list[str]:
        """Return the files of weights that the repository holds with another content, or lacks for results of them."""
        if not contents.weights:
            return []
        held = repository_weights(self.api, self.name)
        return other_weights(contents.weights, held, complete=bool(contents.adds_to))

    def _refuse_results_of_another(self, contents: Contents, other: list[str], said: str) -> None:
        """Refuse results of another policy, unless the user ``said`` that the repository holds it."""
        policy, here = contents.policy, f"{self.name}: {contents.source} is of {contents.policy}"
        if said and said != policy:
            raise HubError(f"{here}, not of {said}")
        add = f"add --policy {policy} if this repository holds what was evaluated"
        if other and not said:
            raise HubError(f"{here}, whose {other[0]} is not the repository's; push that checkpoint, or {add}")
        if not (said or contents.weights or policy == self.name):
            raise HubError(f"{here}, and nothing shows that this repository holds it; {add}")

    def _upload(self, contents: Contents, renewed: bool) -> None:
        """Make one commit; results of other weights than a ``renewed`` checkpoint's are removed in it."""
        self.api.upload_folder(
            repo_id=self.name,
            folder_path=contents.folder,
            repo_type=contents.repo_type,
            ignore_patterns=list(contents.ignored),
            commit_message=f"Push {contents.folder.name} with dynahoi",
            delete_patterns=[f"{RESULTS}/*"] if renewed else None,
        )

    def _add_card(self, contents: Contents) -> None:
        self.api.upload_file(
            repo_id=self.name,
            path_or_fileobj=contents.card.encode(),
            path_in_repo=CARD_PATH,
            repo_type=contents.repo_type,
            commit_message="Add a card with dynahoi",
        )

    def _tag(self, contents: Contents, tag: str) -> None:
        """Set a tag on the latest commit; one that exists is moved."""
        from huggingface_hub.errors import RevisionNotFoundError

        with suppress(RevisionNotFoundError):
            self.api.delete_tag(self.name, tag=tag, repo_type=contents.repo_type)
        self.api.create_tag(self.name, tag=tag, repo_type=contents.repo_type)
