"""``dynahoi push`` of checkpoints and results."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynahoi_lerobot.evaluate.results import write_results
from dynahoi_lerobot.hub.leaderboards import eval_yaml
from dynahoi_lerobot.sampling.recipe import Recipe
from tests.hub.conftest import Push
from tests.hub.server import Hub
from tests.synthetic import synthetic_episode

REPO = "models/me/policy"


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    folder = tmp_path / "pretrained_model"
    (folder / "training_state").mkdir(parents=True)
    (folder / "training_state/rng.safetensors").write_bytes(b"state")
    (folder / "config.json").write_text(json.dumps({"type": "obact"}))
    (folder / "model.safetensors").write_bytes(b"weights")
    (folder / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": "me/catching"}}))
    return folder


def write(folder: Path, split: str, count: int, **recipe: object) -> Path:
    """Write the results of ``count`` episodes that all are the same."""
    episode = synthetic_episode(0, image_size=None)
    played = Recipe(split=split, **recipe)
    write_results(
        folder, [replace(episode, meta=replace(episode.meta, seed=seed)) for seed in range(count)],
        policy="me/policy", split=split, capture="attach", command="dynahoi evaluate", fingerprint="f",
        extra={"inference": "async 150 ms", "recipe": played.stored()},
    )  # fmt: skip
    return folder


@pytest.fixture
def results(tmp_path: Path) -> Path:
    return write(tmp_path / "results", "ood_speed", 220)


def test_a_checkpoint_without_a_card_gets_one(checkpoint: Path, hub: Hub, push: Push):
    code, _, err = push(checkpoint, "me/policy")
    assert code == 0, err
    files = hub.repos[REPO].files
    assert set(files) == {"README.md", "config.json", "model.safetensors", "train_config.json"}
    _, head, body = files["README.md"].decode().split("---\n", 2)
    metadata = yaml.safe_load(head)
    assert metadata["library_name"] == "lerobot"
    assert metadata["datasets"] == ["me/catching"]
    assert "dynahoi evaluate --policy me/policy" in body


def test_a_card_that_is_there_stays(checkpoint: Path, hub: Hub, push: Push):
    (checkpoint / "README.md").write_text("mine")
    push(checkpoint, "me/policy")
    assert hub.repos[REPO].files["README.md"] == b"mine"


def test_later_weights_of_the_same_policy_are_a_new_commit(checkpoint: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    (checkpoint / "model.safetensors").write_bytes(b"better weights")
    assert push(checkpoint, "me/policy")[0] == 0
    weights = [files.get("model.safetensors") for files in hub.repos[REPO].commits.values()]
    assert weights == [None, b"weights", b"better weights"]


def test_another_policy_is_not_overwritten(checkpoint: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    (checkpoint / "config.json").write_text(json.dumps({"type": "act"}))
    code, _, err = push(checkpoint, "me/policy")
    assert code == 1
    assert "me/policy holds other content (the type in config.json is obact, not act); choose another name" in err
    assert len(hub.repos[REPO].commits) == 2


def test_pickles_are_refused(checkpoint: Path, hub: Hub, push: Push):
    (checkpoint / "optimizer.pt").write_bytes(b"pickle")
    code, _, err = push(checkpoint, "me/policy")
    assert code == 2
    assert "holds the pickle optimizer.pt" in err
    assert hub.repos == {}


def test_results_need_their_checkpoint(results: Path, hub: Hub, push: Push):
    code, _, err = push(results, "me/policy")
    assert (code, err.count("\n")) == (1, 1)
    assert "me/policy: there is no such checkpoint on the Hub; push it before its results" in err
    assert hub.repos == {}


def test_results_say_what_was_measured_and_how(checkpoint: Path, results: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    code, _, err = push(results, "me/policy", "--leaderboard", "org/benchmark")
    assert code == 0, err
    name = "ood_speed_attach_standard_async_150_ms"
    files = hub.repos[REPO].files
    assert {"config.json", f"results/{name}/actions.npz", f"results/{name}/episodes.parquet"} < set(files)
    entries = {entry["dataset"]["task_id"]: entry for entry in yaml.safe_load(files[f".eval_results/{name}.yaml"])}
    entry = entries["ood_speed_attach_standard_S_loc"]
    assert entry["dataset"]["id"] == "org/benchmark"
    assert entry["value"] == json.loads((results / "metrics.json").read_text())["metrics"]["S_loc"]["value"]
    assert entry["source"]["url"] == f"{hub.url}/me/policy/tree/main/results/{name}"
    assert "unit fraction" in entry["notes"]
    assert "220 episodes of ood_speed" in entry["notes"]
    assert "inference async 150 ms" in entry["notes"]
    assert np.isfinite([entry["value"] for entry in entries.values()]).all()
    assert set(entries) <= {task["id"] for task in yaml.safe_load(eval_yaml())["tasks"]}
    assert len(entries) == 4


UNRANKED: list[tuple[str, int, dict, str]] = [
    ("val", 3, {}, "there is none for val, attach, standard"),
    ("ood_speed", 219, {}, "219 of the 220 episodes of ood_speed were played"),
    ("ood_speed", 220, {"motions": ("lob",)}, "it was played with other motions than the benchmark's"),
    ("ood_speed", 220, {"protocol": "direct_act"}, "it was played with other protocol than the benchmark's"),
]


@pytest.mark.parametrize(("split", "count", "recipe", "reason"), UNRANKED)
def test_results_on_no_leaderboard_are_pushed_without_entries(
    split: str, count: int, recipe: dict, reason: str, *, checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    push(checkpoint, "me/policy")
    code, out, err = push(write(tmp_path / "results", split, count, **recipe), "me/policy")
    assert code == 0, err
    assert f"no leaderboard lists it: {reason}\n" in out
    files = hub.repos[REPO].files
    assert not [name for name in files if name.startswith(".eval_results")]
    assert [name for name in files if name.endswith("actions.npz")]


def test_damaged_results_are_refused(checkpoint: Path, results: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    (results / "actions.npz").write_bytes(b"")
    code, _, err = push(results, "me/policy")
    assert code == 2
    assert "actions.npz is damaged" in err
    assert len(hub.repos[REPO].commits) == 2
