"""The Hub's client, led to a server in this process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.results import RunInfo, write_results
from dynahoi_lerobot.sampling.recipe import Recipe
from tests.hub.server import TOKEN, Hub, serving
from tests.synthetic import synthetic_episode

Push = Callable[..., tuple[int, str, str]]
"""Run ``dynahoi push`` and return its exit code and what it printed on both streams."""


@pytest.fixture
def hub() -> Iterator[Hub]:
    with serving() as hub:
        yield hub


@pytest.fixture
def push(hub: Hub, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Push:
    from huggingface_hub import constants

    template = constants.HUGGINGFACE_CO_URL_TEMPLATE.replace(constants.ENDPOINT, hub.url)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(constants, "ENDPOINT", hub.url)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub_cache"))
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no_token"))
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)  # the server has only the large file storage
    monkeypatch.setenv("HF_TOKEN", TOKEN)

    def run(*words: object) -> tuple[int, str, str]:
        code = main(["push", *map(str, words)])
        return code, *capsys.readouterr()

    return run


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("hub") / "dataset"
    assert main(["generate", "--root", str(root), "--episodes", "2", "--image-size", "32"]) == 0
    return root


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    folder = tmp_path / "pretrained_model"
    (folder / "training_state").mkdir(parents=True)
    (folder / "training_state/rng.safetensors").write_bytes(b"state")
    (folder / "config.json").write_text(json.dumps({"type": "obact"}))
    (folder / "model.safetensors").write_bytes(b"weights")
    (folder / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": "me/catching"}}))
    return folder


def write_split(
    folder: Path, split: str, seeds: Iterable[int], *, policy: str = "me/policy", command: str = "dynahoi evaluate",
    extra: dict | None = None, **recipe: object,
) -> Path:  # fmt: skip
    """Write the results of episodes that all are the same but for their seeds."""
    episode = synthetic_episode(0, image_size=None)
    played = Recipe(split=split, **recipe).stored()
    info = RunInfo(policy, split, "attach", command, "f", {"recipe": played} | (extra or {}))
    write_results(folder, [replace(episode, meta=replace(episode.meta, seed=seed)) for seed in seeds], info)
    return folder
