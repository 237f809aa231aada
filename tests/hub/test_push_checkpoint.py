"""``dynahoi push`` of checkpoints: with a card, never over another policy, over other weights only if that is asked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from tests.hub.conftest import Push, write_split
from tests.hub.server import Hub

REPO = "models/me/policy"


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
    assert 'pip install ".[lerobot]" ./envs/lerobot_env_dynahoi ./policies/lerobot_policy_obact ' in body


@pytest.mark.parametrize(("size", "mode"), [(4, "grasp"), (18, "joints")])
def test_a_card_names_the_control_mode(size: int, mode: str, checkpoint: Path, hub: Hub, push: Push):
    config = {"type": "act", "output_features": {"action": {"type": "ACTION", "shape": [size]}}}
    (checkpoint / "config.json").write_text(json.dumps(config))
    push(checkpoint, "me/policy")
    assert f"control_mode `{mode}`" in hub.repos[REPO].files["README.md"].decode()


@pytest.mark.parametrize(
    ("kind", "needed"),
    [("actiontokens", " ./policies/lerobot_policy_actiontokens"), ("act", ""), ("smolvla", ' "lerobot[smolvla]"')],
)
def test_a_card_names_what_the_type_of_policy_needs(kind: str, needed: str, checkpoint: Path, hub: Hub, push: Push):
    (checkpoint / "config.json").write_text(json.dumps({"type": kind}))
    push(checkpoint, "me/policy")
    card = hub.repos[REPO].files["README.md"].decode()
    assert f'pip install ".[lerobot]" ./envs/lerobot_env_dynahoi{needed} ' in card


def test_a_card_that_is_there_stays(checkpoint: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    hub.repos[REPO].files["README.md"] = b"edited on the Hub"
    push(checkpoint, "me/policy")
    assert hub.repos[REPO].files["README.md"] == b"edited on the Hub"
    (checkpoint / "README.md").write_text("mine")
    push(checkpoint, "me/policy")
    assert hub.repos[REPO].files["README.md"] == b"mine"


def test_other_weights_replace_the_old_ones_and_their_results_only_if_that_is_asked(
    checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    push(checkpoint, "me/policy")
    push(write_split(tmp_path / "results", "ood_speed", range(220)), "me/policy")
    commits = list(hub.repos[REPO].commits)
    assert push(checkpoint, "me/policy", "--replace")[0] == 0
    assert list(hub.repos[REPO].commits) == commits, "the same weights keep their results"
    (checkpoint / "model.safetensors").write_bytes(b"better weights")
    code, _, err = push(checkpoint, "me/policy")
    assert (code, err.count("\n")) == (1, 1)
    assert "me/policy holds other weights (model.safetensors); choose another name, or add --replace" in err
    assert list(hub.repos[REPO].commits) == commits
    assert push(checkpoint, "me/policy", "--replace")[0] == 0
    files = hub.repos[REPO].files
    assert files["model.safetensors"] == b"better weights"
    assert not [name for name in files if "results" in name]


def test_another_policy_is_not_overwritten(checkpoint: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    (checkpoint / "config.json").write_text(json.dumps({"type": "act"}))
    code, _, err = push(checkpoint, "me/policy")
    assert code == 1
    assert "me/policy holds other content (the type in config.json is obact, not act); choose another name" in err
    assert len(hub.repos[REPO].commits) == 3


def test_pickles_are_refused(checkpoint: Path, hub: Hub, push: Push):
    (checkpoint / "optimizer.pt").write_bytes(b"pickle")
    code, _, err = push(checkpoint, "me/policy")
    assert code == 2
    assert "holds the pickle optimizer.pt" in err
    assert hub.repos == {}
