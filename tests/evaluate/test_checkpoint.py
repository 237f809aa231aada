"""A checkpoint that would run code is refused before it can: the marker that its code would leave
never appears.
"""

import hashlib
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
import torch
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.processor import IdentityProcessorStep, ProcessorStepRegistry
from lerobot.utils.import_utils import register_third_party_plugins
from safetensors.torch import load_file, save_file

from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.evaluate.checkpoint import checked_folder
from dynahoi_lerobot.evaluate.checkpoint_files import WEIGHTS, PolicyError
from dynahoi_lerobot.evaluate.checkpoint_rules import trained_for
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.results import read_results
from tests.checkpoints import FEATURES, SHIPPED, saved, tiny_act
from tests.tools import dynahoi, edit_json

PREPROCESSOR = "policy_preprocessor.json"


def program(marker: Path) -> dict[str, Any]:
    """Return a processor step that LeRobot would load by calling ``os.mkdir(MARKER)``."""
    return {"class": "os.mkdir", "config": {"path": str(marker)}}


def add_step(folder: Path, step: object, pipeline: str = PREPROCESSOR) -> None:
    edit_json(folder / pipeline, lambda content: content["steps"].append(step))


@pytest.fixture(scope="module", autouse=True)
def plugins() -> None:
    register_third_party_plugins()


@pytest.fixture
def checkpoint(actor: Path, tmp_path: Path) -> Path:
    folder = shutil.copytree(actor, tmp_path / "checkpoint")
    (folder / "train_config.json").write_text("{}")
    return folder


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    return tmp_path / "it_ran"


@pytest.mark.parametrize(
    ("command", "pipeline"),
    [("evaluate --episodes 1", PREPROCESSOR), ("view --motion lob", "policy_postprocessor.json")],
)
def test_a_step_that_is_a_program_is_refused_by_every_command(
    command, pipeline, checkpoint, marker
):
    add_step(checkpoint, program(marker), pipeline)
    out = checkpoint.parent / "x.gif"
    message = dynahoi(*command.split(), "--policy", checkpoint, "--out", out, code=2).err
    assert "'os.mkdir'" in message
    assert "--trust" in message
    assert not marker.exists()


def test_trust_says_what_it_lets_lerobot_run(checkpoint, marker, capsys):
    add_step(checkpoint, program(marker))
    with pytest.raises(PolicyError, match="ProcessorStep"):
        PolicyAgent(str(checkpoint), trust=True)
    assert marker.exists(), "LeRobot asks what a step is only after calling it"
    assert f"{PREPROCESSOR} names the processor step 'os.mkdir'" in capsys.readouterr().err


def test_a_third_partys_step_plays_with_trust(checkpoint: Path) -> None:
    @ProcessorStepRegistry.register("a_third_partys_step")
    class Step(IdentityProcessorStep):
        pass

    try:
        add_step(checkpoint, {"registry_name": "a_third_partys_step", "config": {}})
        with pytest.raises(PolicyError, match=r"a_third_partys_step.*--trust"):
            PolicyAgent(str(checkpoint))
        assert PolicyAgent(str(checkpoint), trust=True).weights
    finally:
        ProcessorStepRegistry.unregister("a_third_partys_step")


@pytest.mark.parametrize(
    "step",
    [
        {"class": "dynahoi_lerobot.evaluate.policy_agent.PolicyAgent", "config": {"path": "x"}},
        {"class": ["subprocess.Popen"]},
        {"registry_name": "no_such_step", "class": "lerobot.processor.DeviceProcessorStep"},
        {
            "registry_name": "reward_classifier_processor",
            "config": {"pretrained_path": "you/classifier"},
        },
        {"registry_name": "device_processor", "config": {"pretrained_path": "x"}},
        {"registry_name": "action_tokenizer_processor", "config": {}},
        {"class": "lerobot.processor.DeviceProcessorStep", "config": {}},
        {"registry_name": "device_processor", "state_file": "../../secret.safetensors"},
        {"registry_name": "device_processor", "state_file": None},
        {},
    ],
)
def test_steps_keys_and_states_that_are_not_listed_are_refused(
    step: dict[str, Any], checkpoint: Path
) -> None:
    add_step(checkpoint, step)
    with pytest.raises(PolicyError, match="--trust"):
        checked_folder(str(checkpoint))


REPOSITORY_CODE = {
    "a tokenizer": (
        {"tokenizer_config.json": {"auto_map": {"AutoTokenizer": ["evil.Evil", None]}}},
        {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "OTHER"}},
        {},
    ),
    "a tokenizer of actions": (
        {"tokenizer_config.json": {"auto_map": {"AutoTokenizer": ["evil.Evil", None]}}},
        {
            "registry_name": "action_tokenizer_processor",
            "config": {"action_tokenizer_name": "OTHER"},
        },
        {},
    ),
    "a backbone": (
        {
            "config.json": {"model_type": "evil", "auto_map": {"AutoConfig": "evil.Evil"}},
            "preprocessor_config.json": {"image_mean": [0.5] * 3, "image_std": [0.5] * 3},
        },
        None,
        {"encoder": "transformers", "encoder_options": {"name": "OTHER"}},
    ),
}
"""What another repository holds, and a step or settings of a config that name it."""


@pytest.mark.parametrize("name", REPOSITORY_CODE)
def test_code_of_another_repository_does_not_run_and_nobody_is_asked(
    name, checkpoint, marker, monkeypatch
):
    monkeypatch.setattr("builtins.input", lambda _: pytest.fail("transformers asks"))
    other = checkpoint.parent / "other"
    other.mkdir()
    told = json.dumps(REPOSITORY_CODE[name]).replace("OTHER", str(other))
    files, step, settings = json.loads(told)
    (other / "config.json").write_text('{"model_type": "bert"}')
    for file, content in files.items():
        (other / file).write_text(json.dumps(content))
    (other / "evil.py").write_text(f"import os\nos.mkdir({str(marker)!r})\nclass Evil: ...\n")
    if step is not None:
        edit_json(checkpoint / PREPROCESSOR, steps=[step])
    edit_json(checkpoint / "config.json", **settings)
    with pytest.raises(PolicyError, match=r"cannot be loaded|--trust"):
        PolicyAgent(str(checkpoint))
    assert not marker.exists()


def test_a_policy_plays_without_transformers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    assert PolicyAgent(str(SHIPPED)).weights


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without a GPU")
def test_a_checkpoint_that_was_trained_on_a_gpu_plays_without_one(checkpoint: Path) -> None:
    for name in ("config.json", PREPROCESSOR):
        file = checkpoint / name
        told = file.read_text()
        assert '"device": "cpu"' in told
        file.write_text(told.replace('"device": "cpu"', '"device": "cuda"'))
    assert PolicyAgent(str(checkpoint)).weights


def test_a_policy_that_is_not_installed_or_not_there_is_named(
    checkpoint: Path, monkeypatch
) -> None:
    edit_json(checkpoint / "config.json", type="elsewhere")
    with pytest.raises(PolicyError, match=r"'elsewhere'.*install lerobot_policy_elsewhere"):
        PolicyAgent(str(checkpoint), trust=True)
    monkeypatch.setattr(
        huggingface_hub,
        "snapshot_download",
        lambda *_, **__: (_ for _ in ()).throw(ConnectionError()),
    )
    with pytest.raises(PolicyError, match=r"there is no policy 'you/nothing' \(ConnectionError\)"):
        PolicyAgent("you/nothing")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("config.json", b'{"auto_map": {"AutoModel": "evil.Model"}}'),
        ("backbone/config.json", b'{"text": [{"auto_map": {}}]}'),
        ("tokenizer_config.json", b'{"trust_remote_code": true}'),
        ("config.json", b'{"type": "pi0_fast"}'),
        ("config.json", b'{"type": "obact", "encoder_options": {"trust_remote_code": 1}}'),
        ("config.json", b'{"type": "os.mkdir"}'),
        ("pytorch_model.bin", b""),
        ("backbone/weights.PT", b""),
    ],
)
def test_files_that_hold_or_ask_for_code_are_refused(
    name: str, content: bytes, checkpoint: Path
) -> None:
    (checkpoint / name).parent.mkdir(exist_ok=True)
    (checkpoint / name).write_bytes(content)
    with pytest.raises(PolicyError, match="--trust"):
        checked_folder(str(checkpoint))


@pytest.mark.parametrize("damage", ["one fewer", "one more", "misshapen"])
def test_weights_that_do_not_fit_are_refused(damage: str, checkpoint: Path) -> None:
    weights = load_file(checkpoint / WEIGHTS)
    name = next(name for name, tensor in weights.items() if tensor.dim() == 2)
    damaged = {
        "one fewer": {key: tensor for key, tensor in weights.items() if key != name},
        "one more": weights | {"surplus": torch.zeros(3)},
        "misshapen": weights | {name: weights[name][:, :-1].contiguous()},
    }
    save_file(damaged[damage], checkpoint / WEIGHTS)
    with pytest.raises(PolicyError, match=r"weights|size mismatch"):
        PolicyAgent(str(checkpoint))


def test_statistics_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    act = tiny_act(tmp_path / "act", FEATURES["input_features"])
    config = PreTrainedConfig.from_pretrained(str(act))
    config.normalization_mapping["STATE"] = NormalizationMode.MEAN_STD
    with pytest.raises(PolicyError, match=r"observation\.state"):
        PolicyAgent(str(saved(config, tmp_path / "none")))
    ones = {"std": torch.ones(18)}
    fitting = {"observation.state": ones | {"mean": torch.zeros(18)}}
    assert PolicyAgent(str(saved(config, tmp_path / "fitting", fitting))).weights
    for shape in ((18, 18), (17,)):
        misshapen = {"observation.state": ones | {"mean": torch.zeros(shape)}}
        folder = saved(config, tmp_path / str(shape), misshapen)
        with pytest.raises(
            PolicyError, match=r"policy_preprocessor\.json normalizes observation\.state"
        ):
            PolicyAgent(str(folder))


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        (PREPROCESSOR, {"steps": [1]}, PREPROCESSOR),
        ("train_config.json", {"env": "x"}, "train_config.json"),
        ("config.json", {"encoder": "os.mkdir"}, "os.mkdir"),
        ("config.json", {"n_layers": 10**6}, "n_layers is 1000000; it must be 10000 or less"),
        ("config.json", {"head_options": {"n_layers": 10**6}}, "head_options is 1000000"),
        ("config.json", {"fps": 20}, "fps"),
        ("config.json", {"head_options": {"n_steps": 0}}, "head_options"),
    ],
)
def test_values_that_nothing_can_play_are_one_sentence(
    name: str, change: dict, sentence: str, checkpoint: Path
) -> None:
    edit_json(checkpoint / name, **change)
    message = dynahoi("evaluate", "--policy", checkpoint, "--episodes", "1", code=2).err
    assert sentence in message
    assert message.count("\n") == 1


def test_a_checkpoint_plays_under_the_rules_it_was_trained_for(checkpoint, tmp_path):
    late = {"type": "dynahoi", "control_class": "late", "capture": "contact"}
    edit_json(checkpoint / "train_config.json", env=late)
    words = ["evaluate", "--policy", checkpoint, "--episodes", "1", "--out"]
    assert "--control-class late" in dynahoi(*words, tmp_path / "own").out
    results = read_results(tmp_path / "own")
    assert (
        results.info.extra["weights"][WEIGHTS]
        == hashlib.sha256((checkpoint / WEIGHTS).read_bytes()).hexdigest()
    )
    recipe = results.recipe().rules
    assert (recipe.capture, recipe.control_class, recipe.image_size) == ("contact", "late", 32)
    dynahoi(*words, tmp_path / "told", "--control-class", "unlimited")
    assert read_results(tmp_path / "told").recipe().rules.control_class == "unlimited"


@pytest.mark.parametrize("env", [None, {"type": "dynahoi", "control_class": "standard"}])
def test_the_dataset_tells_what_a_checkpoint_was_trained_for(
    env, checkpoint: Path, tmp_path: Path
) -> None:
    (tmp_path / "data" / "meta").mkdir(parents=True)
    rules = {"capture": "contact", "control_class": "late", "protocol": "direct_act"}
    recording = {"recipe": {"rules": rules}}
    Manifest(0, 0, {}, provenance={"recording": recording}).write(tmp_path / "data")
    edit_json(
        checkpoint / "train_config.json",
        env=env,
        dataset={"root": str(tmp_path / "data")},
    )
    seen = {"image_size": 32, "views": (), "environment_state": ""}
    assert trained_for(checkpoint) == rules | seen
    camera = {"observation.images.ego_motion": {"type": "VISUAL", "shape": [3, 64, 64]}}
    edit_json(checkpoint / "config.json", input_features=camera)
    assert trained_for(checkpoint)["image_size"] == 64, "of any camera"


def test_a_misspelt_baseline_is_told_the_one_it_resembles():
    with pytest.raises(PolicyError, match="pursuit"):
        PolicyAgent("pursit")
