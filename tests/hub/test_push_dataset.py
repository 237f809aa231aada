"""``dynahoi push`` of a dataset: sound ones only, resumed after an interruption, never over other content."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from tests.hub.conftest import Push
from tests.hub.server import TOKEN, Hub

REPO = "datasets/me/catching"


def test_every_file_arrives_and_both_tags_are_set(simulated: Path, hub: Hub, push: Push):
    code, out, err = push(simulated, "me/catching")
    assert code == 0, err
    assert f"dataset pushed to {hub.url}/{REPO}, tagged v3.0, dynahoi-{BENCHMARK.version}" in out
    repo = hub.repos[REPO]
    assert not repo.private
    assert {name: len(content) for name, content in repo.files.items()} == {
        path.relative_to(simulated).as_posix(): path.stat().st_size for path in simulated.rglob("*") if path.is_file()
    }
    assert repo.tags == {"v3.0": repo.head, f"dynahoi-{BENCHMARK.version}": repo.head}
    assert TOKEN not in out + err


def test_pushing_again_changes_nothing(simulated: Path, hub: Hub, push: Push):
    push(simulated, "me/catching", "--private")
    assert hub.repos[REPO].private
    commits = list(hub.repos[REPO].commits)
    hub.requests.clear()
    assert push(simulated, "me/catching", "--private")[0] == 0
    assert list(hub.repos[REPO].commits) == commits
    assert not [line for line in hub.requests if line.startswith("PUT")]


def test_an_interrupted_upload_goes_on(simulated: Path, hub: Hub, push: Push):
    hub.uploads_left = 2
    code, _, err = push(simulated, "me/catching")
    assert code == 1
    assert "507 (storage is full, [REDACTED])" in err
    assert TOKEN not in err
    assert hub.repos[REPO].files == {}
    assert len(hub.blobs) == 2
    hub.uploads_left = None
    hub.requests.clear()
    assert push(simulated, "me/catching")[0] == 0
    sent = [line for line in hub.requests if line.startswith("PUT")]
    large = {line.rpartition("/")[2] for line in sent} | set(hub.blobs)
    assert len(sent) == len(large) - 2


def test_a_damaged_dataset_is_refused(simulated: Path, tmp_path: Path, hub: Hub, push: Push):
    broken = shutil.copytree(simulated, tmp_path / "broken")
    (broken / "meta/tasks.parquet").unlink()
    code, _, err = push(broken, "me/catching")
    assert code == 1
    assert "tasks.parquet is missing" in err
    assert str(broken) in err
    assert hub.repos == {}


def test_another_dataset_of_the_same_files_is_not_overwritten(simulated: Path, tmp_path: Path, hub: Hub, push: Push):
    push(simulated, "me/catching")
    before = dict(hub.repos[REPO].commits)
    root = tmp_path / "other"
    assert main(["generate", "--root", str(root), "--episodes", "2", "--image-size", "32", "--seed", "9"]) == 0
    code, _, err = push(root, "me/catching")
    assert code == 1
    assert f"holds other content (the sha256 in meta/manifest.json is {Manifest.read(simulated).digest}, not" in err
    assert hub.repos[REPO].commits == before


def test_a_repository_of_something_else_is_left_alone(simulated: Path, hub: Hub, push: Push):
    push(simulated, "me/catching")
    hub.repos[REPO].commits["f" * 40] = {"thesis.pdf": b"years of work"}
    code, _, err = push(simulated, "me/catching")
    assert (code, err.count("\n")) == (1, 1)
    assert "me/catching holds other content (thesis.pdf); choose another name" in err
    assert hub.repos[REPO].files == {"thesis.pdf": b"years of work"}


def test_what_is_to_be_private_does_not_go_into_a_public_repository(simulated: Path, hub: Hub, push: Push):
    push(simulated, "me/catching")
    code, _, err = push(simulated, "me/catching", "--private")
    assert code == 1
    assert "me/catching exists and is public" in err


@pytest.mark.parametrize(
    "case",
    [
        ("me/catching", "hf_" + "wrong" * 6, "rejected the token"),
        ("me/catching", "", "token"),
        ("you/catching", TOKEN, "you/catching: the token has no write access"),
    ],
)
def test_tokens_that_will_not_do(simulated: Path, hub: Hub, push: Push, monkeypatch, case: tuple[str, str, str]):
    repo, token, said = case
    monkeypatch.setenv("HF_TOKEN", token)
    code, out, err = push(simulated, repo)
    assert (code, out) == (1, "")
    assert said in err
    assert not token or token not in err
    assert hub.repos == {}


@pytest.mark.parametrize("name", ["catching", "a/b/c", "me/a b", "", "../x"])
def test_names_that_are_none(simulated: Path, hub: Hub, push: Push, name: str):
    code, _, err = push(simulated, name)
    assert (code, err.count("\n")) == (2, 1)
    assert f"the repository is {name!r}; it must be USER/NAME" in err
    assert hub.requests == []


def test_a_folder_that_is_nothing(tmp_path: Path, push: Push):
    code, _, err = push(tmp_path, "me/catching")
    assert code == 2
    assert "holds none of these: dataset (meta/info.json), results (metrics.json), checkpoint (config.json)" in err
