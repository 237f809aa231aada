"""``dynahoi push`` of results: beside the checkpoint that they are of, each under a name of its own."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import yaml

from tests.hub.conftest import Push, write_split
from tests.hub.server import Hub

REPO = "models/me/policy"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    return write_split(tmp_path / "results", "ood_speed", range(220), extra={"inference": "async 150 ms"})


def test_results_need_their_checkpoint(results: Path, hub: Hub, push: Push):
    code, _, err = push(results, "me/policy")
    assert (code, err.count("\n")) == (1, 1)
    assert "me/policy holds no checkpoint" in err
    assert hub.repos == {}


def test_results_say_what_was_measured_and_how(checkpoint: Path, results: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    code, _, err = push(results, "me/policy")
    assert code == 0, err
    name = "v2_ood_speed_attach_standard_async_150_ms"
    files = set(hub.repos[REPO].files)
    assert {"config.json", *(f"results/{name}/{file.name}" for file in results.iterdir())} <= files


def test_damaged_results_are_refused(checkpoint: Path, results: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    (results / "actions.npz").write_bytes(b"")
    code, _, err = push(results, "me/policy")
    assert code == 2
    assert "actions.npz is damaged" in err
    assert names(hub) == set()


def names(hub: Hub) -> set[str]:
    """Return the names of the result folders in the repository."""
    return {name.split("/")[1] for name in hub.repos[REPO].files if name.startswith("results/")}


WHOLE = "v2_ood_speed_attach_standard"
OTHERS: list[tuple[dict, str]] = [
    ({"protocol": "occluded"}, f"{WHOLE}_protocol_occluded"),
    ({"appearance": ("lights",)}, f"{WHOLE}_appearance_lights"),
    ({"hand": "opposed"}, f"{WHOLE}_hand_opposed"),
    ({"objects": ("ball", "cup")}, f"{WHOLE}_objects_ball_cup"),
    ({"motions": ("lob",)}, f"{WHOLE}_motions_lob"),
    ({"image_size": 64}, f"{WHOLE}_image_size_64"),
    ({"extra": {"settings": ["n_action_steps=-1"]}}, f"{WHOLE}_n_action_steps_-1"),
    ({"seeds": range(3)}, f"{WHOLE}_3_episodes"),
    ({"seeds": range(3), "protocol": "occluded"}, f"{WHOLE}_protocol_occluded_3_episodes"),
    ({"seeds": (7, 8, 9)}, f"{WHOLE}_3_episodes_" + hashlib.sha256(b"[7, 8, 9]").hexdigest()[:8]),
]


def test_results_under_other_rules_or_of_fewer_episodes_have_other_names(
    checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    push(checkpoint, "me/policy")
    push(write_split(tmp_path / "whole", "ood_speed", range(220)), "me/policy")
    ranked = {name: content for name, content in hub.repos[REPO].files.items() if WHOLE in name}
    for number, (options, _) in enumerate(OTHERS):
        seeds, rest = options.get("seeds", range(220)), {k: v for k, v in options.items() if k != "seeds"}
        code, _, err = push(write_split(tmp_path / str(number), "ood_speed", seeds, **rest), "me/policy")
        assert code == 0, err
    assert names(hub) == {WHOLE, *(name for _, name in OTHERS)}
    assert ranked.items() <= hub.repos[REPO].files.items()


STRANGERS = ["you/other", "intercept"]


@pytest.mark.parametrize("policy", STRANGERS)
def test_results_of_another_policy_are_refused_unless_they_are_said_to_be_of_this_one(
    policy: str, *, checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    push(checkpoint, "me/policy")
    results = write_split(tmp_path / "results", "ood_speed", range(2), policy=policy)
    code, _, err = push(results, "me/policy")
    assert (code, err.count("\n")) == (1, 1)
    assert f"me/policy: {results} is of {policy}, and nothing shows that this repository holds it" in err
    assert names(hub) == set()
    code, _, err = push(results, "me/policy", "--policy", "you/third")
    assert f"{results} is of {policy}, not of you/third" in err
    assert code == 1
    assert push(results, "me/policy", "--policy", policy)[0] == 0


def test_results_go_to_the_repository_with_the_weights_that_they_name(
    checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    push(checkpoint, "me/policy")
    digest = hashlib.sha256((checkpoint / "model.safetensors").read_bytes()).hexdigest()
    for number, (weights, code) in enumerate(
        (({"model.safetensors": "0a" * 32}, 1), ({"model.safetensors": digest}, 0))
    ):
        results = write_split(
            tmp_path / str(number), "ood_speed", range(2), policy=str(checkpoint), extra={"weights": weights}
        )
        assert push(results, "me/policy")[0] == code
    (checkpoint / "model.safetensors").write_bytes(b"trained further")
    push(checkpoint, "me/policy", "--replace")
    code, _, err = push(results, "me/policy")
    assert (code, err.count("\n")) == (1, 1)
    assert push(results, "me/policy", "--policy", checkpoint)[0] == 0


def test_the_card_lists_the_results_once(checkpoint: Path, results: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    for _ in range(2):
        assert push(results, "me/policy")[0] == 0
    _, head, body = hub.repos[REPO].files["README.md"].decode().split("---\n", 2)
    (model,) = yaml.safe_load(head)["model-index"]
    (entry,) = model["results"]
    assert entry["dataset"]["split"] == "ood_speed"
    assert {metric["type"] for metric in entry["metrics"]} == {"S_loc", "S_joint"}
    assert "dynahoi evaluate" in body
    commits = list(hub.repos[REPO].commits)
    assert push(results, "me/policy")[0] == 0
    assert list(hub.repos[REPO].commits) == commits
