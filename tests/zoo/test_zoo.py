"""LeRobot's policies through its own training command and our evaluation: two steps, one episode,
no download.
"""

from pathlib import Path

import pytest
from lerobot.policies.pi0 import modeling_pi0
from lerobot.policies.pi0_fast import modeling_pi0_fast
from lerobot.policies.pi05 import modeling_pi05

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.evaluate.results import read_results
from tests.tools import generated, options, run
from tests.zoo import stand_ins

RECIPES = Path(__file__).parents[2] / "recipes" / "zoo"
SIZE = 64
PALIGEMMA = "google/paligemma-3b-pt-224"
COSMOS = "nvidia/Cosmos-Reason2-2B"
"""On the Hub, or folders of these names where the test runs."""
SMALL = {
    "multi_task_dit": {
        "vision_encoder_name": "CLIP",
        "text_encoder_name": "CLIP",
        "image_resize_shape": [SIZE, SIZE],
        "hidden_dim": 32,
        "num_layers": 1,
        "num_heads": 2,
        "num_inference_steps": 2,
    },
    "actiontokens": {"vlm_name": "SMOLVLM", "load_weights": False},
    "openvla": {"vlm_name": "OPENVLA", "load_weights": False, "dtype": "float32"},
    "smolvla": {
        "vlm_model_name": "SMOLVLM",
        "load_vlm_weights": False,
        "num_vlm_layers": 2,
        "resize_imgs_with_padding": [32, 32],
        "num_steps": 2,
    },
    "pi0": {"dtype": "float32", "image_resolution": [32, 32], "num_inference_steps": 2},
    "pi05": {"dtype": "float32", "image_resolution": [32, 32], "num_inference_steps": 2},
    "pi0_fast": {  # whose random weights write no valid prefix
        "dtype": "float32",
        "image_resolution": [224, 224],
        "text_tokenizer_name": PALIGEMMA,
        "action_tokenizer_name": "FAST",
        "max_action_tokens": 300,
        "max_decoding_steps": 8,
        "validate_action_token_prefix": False,
    },
    "groot": {"base_model_path": "GROOT", "use_bf16": False, "tune_llm": False},
    "upvla": {
        "llm_name": "PHI",
        "image_tokenizer": "CODES",
        "image_tokenizer_folder": "",
        "load_weights": False,
        "image_size": 16,
        "dtype": "float32",
    },
    "xvla": {
        "dtype": "float32",
        "florence_config": stand_ins.tiny_florence(),
        "tokenizer_name": PALIGEMMA,
        "hidden_size": 32,
        "depth": 1,
        "num_heads": 2,
        "len_soft_prompts": 4,
        "num_denoising_steps": 2,
    },
}
"""What makes each small; folders of stand-ins are filled in."""


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("models")
    folders = {
        "CLIP": root / "clip",
        "SMOLVLM": root / "smolvlm",
        "FAST": root / "fast",
        "HUB": root / "hub",
    }
    folders |= {"OPENVLA": root / "openvla", "PHI": root / "phi", "CODES": root / "codes"}
    folders["GROOT"] = root / "GR00T-N1.7"
    stand_ins.save_clip(folders["CLIP"])
    stand_ins.save_smolvlm(folders["SMOLVLM"])
    stand_ins.save_openvla(folders["OPENVLA"], size=18)
    stand_ins.save_phi(folders["PHI"])
    stand_ins.save_image_tokenizer(folders["CODES"])
    stand_ins.save_action_tokenizer(folders["FAST"])
    stand_ins.save_paligemma_tokenizer(folders["HUB"] / PALIGEMMA)
    stand_ins.save_cosmos(folders["HUB"] / COSMOS)
    stand_ins.save_groot(folders["GROOT"], str(folders["HUB"] / COSMOS))
    return {name: str(folder) for name, folder in folders.items()}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generated(
        tmp_path_factory.mktemp("data") / "d",
        "--image-size",
        str(SIZE),
        "--motions",
        "constant,lateral",
    )


@pytest.fixture
def tiny_gemma(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let Pi's models, whose sizes cannot be configured, be small."""
    for module in (modeling_pi0, modeling_pi05, modeling_pi0_fast):
        small = module.GemmaConfig(
            width=16, depth=2, mlp_dim=32, num_heads=8, num_kv_heads=1, head_dim=8
        )
        monkeypatch.setattr(module, "get_gemma_config", lambda variant, small=small: small)
        kind = module.PaliGemmaForConditionalGenerationWithPiGemma
        shrunk = lambda config, kind=kind: kind(stand_ins.shrink_paligemma(config))  # noqa: E731
        monkeypatch.setattr(module, "PaliGemmaForConditionalGenerationWithPiGemma", shrunk)


REMOTE_CODE = ("groot", "pi0_fast")
"""Policies whose own source asks transformers for remote code, so that they are loaded with
``--trust`` only."""


def test_every_recipe_of_the_zoo_is_trained():
    assert {path.stem for path in RECIPES.iterdir()} == set(SMALL)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.usefixtures("tiny_gemma")
def test_two_steps_and_an_episode(name, models, data, tmp_path, monkeypatch):
    monkeypatch.chdir(models["HUB"])
    policy = {
        key: models.get(value, value) if isinstance(value, str) else value
        for key, value in SMALL[name].items()
    }
    camera = {"observation.images.ego": {"type": "VISUAL", "shape": [3, SIZE, SIZE]}}
    state = {"observation.state": {"type": "STATE", "shape": [18]}}
    policy |= {"device": "cpu", "input_features": camera | state}
    told = {
        "dataset.root": str(data),
        "output_dir": str(tmp_path / "out"),
        "steps": 2,
        "save_freq": 2,
        "batch_size": 2,
    }
    told |= {"num_workers": 0, "log_freq": 1} | {
        f"policy.{key}": value for key, value in policy.items()
    }
    run(["lerobot-train", f"--config_path={RECIPES / name}.yaml", *options(told)])
    checkpoint = str(tmp_path / "out" / "checkpoints" / "last" / "pretrained_model")
    played = ["--policy", checkpoint, "--motions", "constant", "--episodes", "1"]
    played += ["--out", str(tmp_path / "r")]
    assert main(["evaluate", *played, *(["--trust"] if name in REMOTE_CODE else [])]) == 0
    results = read_results(tmp_path / "r")
    assert len(results.rows) == 1
    assert results.rows[0]["kind"] == "constant"
    assert results.actions[0].shape[1] == 18
