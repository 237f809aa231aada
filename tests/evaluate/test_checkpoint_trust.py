"""A checkpoint that would run code is refused before it can: the marker that its code would leave never appears."""

from __future__ import annotations

import fnmatch
import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
from lerobot.processor import ProcessorStepRegistry
from lerobot.utils.import_utils import register_third_party_plugins

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.evaluate.checkpoint_trust import PolicyError, UntrustedCheckpointError, check_folder
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent

CHECKPOINT = Path(__file__).parents[2] / "checkpoints" / "tracker_standard"
PREPROCESSOR = "policy_preprocessor.json"


def program(marker: Path) -> dict[str, Any]:
    """Return a processor step that LeRobot would load by calling ``os.mkdir(MARKER)``."""
    return {"class": "os.mkdir", "config": {"path": str(marker)}}


def change(file: Path, edit: Callable[[Any], object]) -> None:
    """Edit a JSON file in place."""
    content = json.loads(file.read_text())
    edit(content)
    file.write_text(json.dumps(content))


def add_step(folder: Path, step: object, pipeline: str = PREPROCESSOR) -> None:
    change(folder / pipeline, lambda content: content["steps"].append(step))


@pytest.fixture(scope="module", autouse=True)
def plugins() -> None:
    register_third_party_plugins()


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    return Path(shutil.copytree(CHECKPOINT, tmp_path / "checkpoint"))


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    return tmp_path / "it_ran"


@pytest.mark.parametrize("pipeline", [PREPROCESSOR, "policy_postprocessor.json"])
@pytest.mark.parametrize("command", ["evaluate --episodes 1", "view --motion lob"])
def test_a_step_that_is_a_program_is_refused_by_every_command(
    command: str, pipeline: str, checkpoint: Path, marker: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add_step(checkpoint, program(marker), pipeline)
    assert cli.main([*command.split(), "--policy", str(checkpoint), "--out", str(checkpoint.parent / "x.gif")]) == 2
    message = capsys.readouterr().err
    assert f"{pipeline} names the processor step 'os.mkdir', which is neither registered" in message
    assert "give --trust only if" in message
    assert not marker.exists()


def test_trust_lets_lerobot_run_it(checkpoint: Path, marker: Path) -> None:
    add_step(checkpoint, program(marker))
    with pytest.raises(TypeError, match="must inherit from ProcessorStep"):
        PolicyAgent(str(checkpoint), trust=True)
    assert marker.exists(), "LeRobot asks what a step is only after calling it"


@pytest.mark.parametrize(
    "step",
    [
        {"class": "subprocess.Popen", "config": {"args": ["true"]}},
        {"class": "dynahoi_lerobot.cli.quickstart.subprocess.Popen", "config": {}},
        {"class": "dynahoi_lerobot.evaluate.policy_agent.PolicyAgent", "config": {"path": "x"}},
        {"class": "Popen"},
        {"class": ["subprocess.Popen"]},
        {"registry_name": ["device_processor"]},
        {"registry_name": "no_such_step", "class": "lerobot.processor.DeviceProcessorStep"},
        {},
    ],
)
def test_other_ways_to_name_a_class_are_refused(step: dict[str, Any], checkpoint: Path) -> None:
    add_step(checkpoint, step)
    with pytest.raises(UntrustedCheckpointError, match="neither registered with LeRobot nor of this project"):
        check_folder(checkpoint)


def test_registered_steps_may_be_named_by_class(checkpoint: Path) -> None:
    step = ProcessorStepRegistry.get("device_processor")
    add_step(checkpoint, {"class": f"{step.__module__}.{step.__qualname__}", "config": {}})
    check_folder(checkpoint)


@pytest.mark.parametrize(
    ("step", "sentence"),
    [
        ({"registry_name": "action_tokenizer_processor", "config": {"action_tokenizer_name": "a/b"}}, "runs code of"),
        ({"registry_name": "device_processor", "config": {"trust_remote_code": True}}, "sets trust_remote_code"),
        ({"registry_name": "device_processor", "state_file": "../../secret.safetensors"}, "is not inside"),
        ({"registry_name": "device_processor", "state_file": "/etc/passwd"}, "is not inside"),
        ({"registry_name": "device_processor", "state_file": ["x"]}, "is not inside"),
    ],
)
def test_registered_steps_with_dangerous_configs_are_refused(
    step: dict[str, Any], sentence: str, checkpoint: Path
) -> None:
    add_step(checkpoint, step)
    with pytest.raises(UntrustedCheckpointError, match=sentence):
        check_folder(checkpoint)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("config.json", {"auto_map": {"AutoModel": "evil.Model"}}, "has an auto_map"),
        ("backbone/config.json", {"text": [{"auto_map": {}}]}, "has an auto_map"),
        ("tokenizer_config.json", {"trust_remote_code": True}, "sets trust_remote_code"),
        ("config.json", {"type": "pi0_fast"}, "of type 'pi0_fast', which runs code of repositories"),
    ],
)
def test_configs_that_ask_for_remote_code_are_refused(
    name: str, content: dict[str, Any], sentence: str, checkpoint: Path
) -> None:
    (checkpoint / name).parent.mkdir(exist_ok=True)
    (checkpoint / name).write_text(json.dumps(content))
    with pytest.raises(UntrustedCheckpointError, match=sentence):
        check_folder(checkpoint)


@pytest.mark.parametrize("name", ["pytorch_model.bin", "a/weights.pt", "w.PTH", "w.pkl", "w.ckpt"])
def test_planted_pickles_are_refused(name: str, checkpoint: Path) -> None:
    (checkpoint / name).parent.mkdir(exist_ok=True)
    (checkpoint / name).write_bytes(pickle.dumps({}))
    with pytest.raises(UntrustedCheckpointError, match="is a pickle"):
        PolicyAgent(str(checkpoint))


@pytest.mark.parametrize("name", ["model.safetensors", "policy_preprocessor.json", "more"])
def test_links_that_lead_out_are_refused(name: str, checkpoint: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    shutil.copytree(CHECKPOINT, outside)
    (checkpoint / name).unlink(missing_ok=True)
    (checkpoint / name).symlink_to(outside / name if (outside / name).exists() else outside)
    with pytest.raises(UntrustedCheckpointError, match="is a link that leads out"):
        PolicyAgent(str(checkpoint))


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        (PREPROCESSOR, "{", "cannot be read as JSON"),
        (PREPROCESSOR, "[" * 10**5, "cannot be read as JSON"),
        (PREPROCESSOR, "[1]", "holds no list of processor steps"),
        (PREPROCESSOR, '{"steps": [1]}', "holds no list of processor steps"),
        (PREPROCESSOR, '{"steps": [{"registry_name": "device_processor", "config": 5}]}', "config 5, which is no"),
        ("config.json", '{"type": ["tracker"]}', "there is no policy"),
        ("config.json", "[]", "there is no policy"),
    ],
)
def test_damaged_files_are_one_sentence(name: str, text: str, sentence: str, checkpoint: Path) -> None:
    (checkpoint / name).write_text(text)
    with pytest.raises(PolicyError, match=sentence):
        PolicyAgent(str(checkpoint))


@pytest.fixture
def hub(checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Serve the checkpoint as the Hub's repository you/tracker, laid out as its cache is; collect what is fetched."""
    cache, fetched = tmp_path / "models--you--tracker", []

    def snapshot_download(repo_id: str, *, revision: str | None, allow_patterns: list[str], **_: object) -> str:
        assert repo_id == "you/tracker"
        folder = cache / "snapshots" / "c0ffee"
        assert revision in (None, folder.name)
        for file in (file for file in checkpoint.rglob("*") if file.is_file()):
            if any(fnmatch.fnmatch(file.name, pattern) for pattern in allow_patterns):
                fetched.append(file.name)
                shutil.copy(file, cache / "blobs" / file.name)
                (folder / file.name).symlink_to(cache / "blobs" / file.name)
        return str(folder)

    (cache / "snapshots" / "c0ffee").mkdir(parents=True)
    (cache / "blobs").mkdir()
    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot_download)
    return fetched


def test_a_hub_repository_is_checked_before_its_weights_are_fetched(
    checkpoint: Path, marker: Path, hub: list[str]
) -> None:
    add_step(checkpoint, program(marker))
    with pytest.raises(UntrustedCheckpointError, match=r"os\.mkdir"):
        PolicyAgent("you/tracker")
    assert not marker.exists()
    assert hub
    assert all(name.endswith(".json") for name in hub)


def test_a_harmless_hub_repository_plays_without_its_other_files(checkpoint: Path, hub: list[str]) -> None:
    (checkpoint / "optimizer.pt").write_bytes(b"never fetched")
    agent = PolicyAgent("you/tracker")
    assert agent.name == "you/tracker"
    assert agent.image_size == 96
    assert "model.safetensors" in hub
    assert "optimizer.pt" not in hub


def test_an_unknown_repository_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def offline(*_: object, **__: object) -> str:
        raise ConnectionError

    monkeypatch.setattr(huggingface_hub, "snapshot_download", offline)
    with pytest.raises(PolicyError, match=r"there is no policy 'you/nothing' \(ConnectionError\)"):
        PolicyAgent("you/nothing")
