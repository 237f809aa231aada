"""LoRA adapters and renamed cameras: what LeRobot trains plays here as it plays there."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import make_policy
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig
from safetensors.torch import load_file, save_file

from dynahoi_lerobot.core.reading import sha256
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.evaluate.checkpoint import checked_folder
from dynahoi_lerobot.evaluate.checkpoint_files import PolicyError
from dynahoi_lerobot.evaluate.checkpoint_rules import trained_for
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.generate.actor import actor_name
from tests.checkpoints import RENAMES, observation, renamed_act, tiny_adapter
from tests.env.test_lerobot_plugin import through_lerobot
from tests.tools import dynahoi, edit_json, generated, lerobot_train


@pytest.fixture(scope="module")
def place(actor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a checkpoint ``base`` and its adapter ``runs/adapter``, which names it so."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copytree(actor, folder / "base")
    tiny_adapter(folder / "base", folder / "runs/adapter", named="base")
    return folder


@pytest.fixture
def adapter(place: Path, tmp_path: Path) -> Path:
    return shutil.copytree(place, tmp_path / "place") / "runs/adapter"


def test_an_adapter_plays_in_every_command_and_results_name_both_weights(adapter, tmp_path):
    dynahoi("evaluate", "--policy", adapter, "--episodes=1", "--out", tmp_path / "results")
    found = read_results(tmp_path / "results")
    base = adapter.parents[1] / "base/model.safetensors"
    assert found.info.extra["weights"] == {
        "adapter_model.safetensors": sha256(adapter / "adapter_model.safetensors"),
        "base/model.safetensors": sha256(base),
    }
    clip = tmp_path / "x.gif"
    dynahoi("view", "--motion", "lob", "--policy", adapter, "--out", clip)
    assert clip.read_bytes()[:4] == b"GIF8"
    words = ("--actor", str(adapter), "--motions=constant", "--image-size=32")
    generated(tmp_path / "data", *words, episodes=1)
    assert len(list(read_episodes(tmp_path / "data"))) == 1


def test_an_adapter_acts_as_lerobot_makes_it_act(adapter: Path, monkeypatch) -> None:
    monkeypatch.chdir(adapter.parents[1])
    config = PreTrainedConfig.from_pretrained(str(adapter))
    config.pretrained_path = adapter
    theirs = make_policy(config, env_cfg=DynahoiEnvConfig(image_size=32)).eval()
    ours = PolicyAgent(str(adapter))._policy
    plain = PolicyAgent("base")._policy
    acted = [policy.select_action(observation(config)) for policy in (theirs, ours, plain)]
    torch.testing.assert_close(acted[0], acted[1], atol=0, rtol=0)
    assert not torch.allclose(acted[0], acted[2]), "the adapter changes something"


def test_the_base_is_found_from_any_folder(adapter: Path, monkeypatch, tmp_path) -> None:
    for folder in (tmp_path, adapter, adapter.parents[1]):
        monkeypatch.chdir(folder)
        assert PolicyAgent(str(adapter)).weights


def test_a_base_that_is_not_there_is_one_sentence(adapter: Path) -> None:
    shutil.rmtree(adapter.parents[1] / "base")
    message = dynahoi("evaluate", "--policy", adapter, "--episodes", "1", code=2).err
    assert message.count("\n") == 1
    assert "adapts 'base'" in message


@pytest.mark.parametrize("name", [".", "..", "runs/adapter"])
def test_an_adapter_of_an_adapter_is_refused(name: str, adapter: Path) -> None:
    edit_json(adapter / "adapter_config.json", base_model_name_or_path=name)
    with pytest.raises(PolicyError):
        checked_folder(str(adapter))


def test_the_base_passes_the_same_checks(adapter: Path, tmp_path: Path) -> None:
    marker = tmp_path / "it_ran"
    step = {"class": "os.mkdir", "config": {"path": str(marker)}}
    pipeline = adapter.parents[1] / "base/policy_preprocessor.json"
    edit_json(pipeline, lambda content: content["steps"].append(step))
    with pytest.raises(PolicyError, match=r"os\.mkdir.*--trust"):
        PolicyAgent(str(adapter))
    assert not marker.exists()


@pytest.mark.parametrize(
    "told",
    [
        {"megatron_config": {"a": 1}, "megatron_core": "evil"},
        {"peft_type": "XLORA"},
        {"eva_config": {"rho": 2.0}},
    ],
)
def test_an_adapter_that_could_make_peft_load_more_is_refused(told: dict, adapter: Path) -> None:
    edit_json(adapter / "adapter_config.json", **told)
    with pytest.raises(PolicyError, match="--trust"):
        checked_folder(str(adapter))


def test_weights_of_an_adapter_that_do_not_fit_are_refused(adapter: Path) -> None:
    file = adapter / "adapter_model.safetensors"
    save_file(dict(list(load_file(file).items())[1:]), file)
    with pytest.raises(PolicyError, match="lacks weights"):
        PolicyAgent(str(adapter))


def test_another_base_is_another_actor(adapter: Path) -> None:
    before = actor_name(str(adapter))
    file = adapter.parents[1] / "base/model.safetensors"
    save_file({name: tensor + 1 for name, tensor in load_file(file).items()}, file)
    assert actor_name(str(adapter)) != before


@pytest.fixture(scope="module")
def act(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return renamed_act(tmp_path_factory.mktemp("act"))


def test_a_checkpoint_with_renamed_cameras_plays(act: Path, tmp_path: Path):
    told = trained_for(act)
    assert (told["views"], told["image_size"]) == (("side",), 32)
    dynahoi("evaluate", "--policy", act, "--episodes=1", "--out", tmp_path)
    assert read_results(tmp_path).recipe().rules.views == ("side",)


def test_lerobot_eval_plays_it_with_and_without_the_map(act: Path, tmp_path: Path):
    option = (f"--rename_map={json.dumps(RENAMES)}",)
    found = [through_lerobot(act, tmp_path / str(len(given)), *given) for given in ((), option)]
    assert found[0].recipe().rules.views == ("side",)
    for one, other in zip(*(results.actions for results in found), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "d"
    return generated(root, "--image-size", "32", "--views", "side", "--motions", "constant")


def played(policy: Path, out: Path) -> None:
    dynahoi("evaluate", "--policy", policy, "--episodes=1", "--motions=constant", "--out", out)


@pytest.mark.nightly
@pytest.mark.slow
def test_lerobot_trains_an_adapter_that_plays_here(actor: Path, data: Path, tmp_path: Path):
    lora = {"peft.method_type": "LORA"}
    played(lerobot_train(data, tmp_path / "out", {"path": actor}, **lora), tmp_path / "results")
    weights = read_results(tmp_path / "results").info.extra["weights"]
    assert {*weights} >= {"adapter_model.safetensors", "base/model.safetensors"}


@pytest.mark.nightly
@pytest.mark.slow
def test_lerobot_trains_with_renamed_cameras_what_plays_here(act: Path, data: Path, tmp_path: Path):
    made = lerobot_train(data, tmp_path / "out", {"path": act}, rename_map=RENAMES)
    played(made, tmp_path / "results")
    assert read_results(tmp_path / "results").recipe().rules.views == ("side",)
