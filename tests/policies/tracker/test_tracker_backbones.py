"""Every image encoder: shapes, independence of frames, published weights."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from lerobot_policy_tracker import TrackerPolicy
from lerobot_policy_tracker.backbones import backbones
from lerobot_policy_tracker.backbones.keypoints import KeypointTokens
from lerobot_policy_tracker.backbones.transformers_vision import pool_patches
from lerobot_policy_tracker.eye import pixel_grid
from tokenizers import Tokenizer, models, pre_tokenizers
from tracker_helpers import make_batch, make_policy
from transformers import (
    Dinov2Config,
    Dinov2Model,
    PreTrainedTokenizerFast,
    SiglipConfig,
    SiglipModel,
    SmolVLMConfig,
    SmolVLMForConditionalGeneration,
)

WIDTH = 16
SMALL_TOWER = {"hidden_size": 8, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2}
SMALL_TOWER |= {"image_size": 32, "patch_size": 8}


def save_image_settings(folder: Path) -> None:
    (folder / "preprocessor_config.json").write_text(json.dumps({"image_mean": [0.5] * 3, "image_std": [0.5] * 3}))


def save_dinov2(folder: Path) -> None:
    Dinov2Model(Dinov2Config(**SMALL_TOWER)).save_pretrained(folder)
    save_image_settings(folder)


def save_siglip(folder: Path) -> None:
    text = {"vocab_size": 32, "hidden_size": 8, "intermediate_size": 16, "num_hidden_layers": 1}
    text |= {"num_attention_heads": 2, "max_position_embeddings": 8, "projection_size": 8}
    SiglipModel(SiglipConfig(text_config=text, vision_config=SMALL_TOWER)).save_pretrained(folder)
    save_image_settings(folder)


def save_smolvlm(folder: Path) -> None:
    text = {"vocab_size": 64, "hidden_size": 12, "intermediate_size": 24, "num_hidden_layers": 3, "model_type": "llama"}
    text |= {"num_attention_heads": 2, "num_key_value_heads": 1, "head_dim": 6, "pad_token_id": 0}
    config = SmolVLMConfig(vision_config=SMALL_TOWER, text_config=text, scale_factor=2, image_token_id=1)
    SmolVLMForConditionalGeneration(config).save_pretrained(folder)
    words = ["<unk>", "catch", "drop", "the", "ball", "cube"]
    tokenizer = Tokenizer(models.WordLevel({word: i for i, word in enumerate(words)}, unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    PreTrainedTokenizerFast(tokenizer_object=tokenizer, unk_token="<unk>").save_pretrained(folder)


SAVERS = {"dinov2": save_dinov2, "siglip": save_siglip, "smolvlm2": save_smolvlm}


@pytest.fixture(scope="module")
def models_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders with tiny random models in the layout of the hub."""
    root = tmp_path_factory.mktemp("models")
    torch.manual_seed(3)
    for name, save in SAVERS.items():
        (root / name).mkdir()
        save(root / name)
    return root


CASES = {
    "eye": ("eye", {"channels": 8, "fovea": 8, "embedding": 4}),
    "conv": ("conv", {"n_keypoints": 4, "channels": 8}),
    "resnet18": ("resnet18", {"weights": "", "n_keypoints": 4}),
    "dinov2": ("transformers_vision", {"name": "dinov2", "grid": 2}),
    "siglip": ("transformers_vision", {"name": "siglip", "grid": 2}),
    "smolvlm2": ("smolvlm2", {"name": "smolvlm2", "grid": 2, "n_layers": 2}),
}


def options_of(case: str, root: Path, **changes: object) -> tuple[str, dict]:
    name, options = CASES[case]
    named = {"name": str(root / options["name"])} if "name" in options else {}
    return name, {**options, **named, **changes}


def test_every_backbone_has_a_case() -> None:
    """Those of several cameras have tests of their own, such as test_tracker_two_eyes.py."""
    assert {name for name, _ in CASES.values()} == {name for name in backbones.names() if name != "two_eyes"}


@pytest.mark.parametrize("case", CASES)
def test_tokens_have_the_width_and_frames_are_independent(case: str, models_root: Path) -> None:
    torch.manual_seed(0)
    name, options = options_of(case, models_root)
    backbone = backbones.build(name, WIDTH, options=options).eval()
    images, texts = torch.rand(3, 3, 40, 48), ["catch the ball", "drop", "catch the ball"]
    tokens = backbone(images, texts)
    assert tokens.shape[0] == 3
    assert tokens.shape[2] == WIDTH
    torch.testing.assert_close(backbone(images[1:2], texts[1:2]), tokens[1:2], rtol=1e-3, atol=1e-4)
    assert (tokens[0] - tokens[2]).abs().max() > 1e-6


@pytest.mark.parametrize("case", [case for case in CASES if case != "smolvlm2"])
def test_backbones_without_text_ignore_it_and_the_policy_adds_its_own(case: str, models_root: Path) -> None:
    name, options = options_of(case, models_root)
    policy = make_policy(backbone=name, backbone_options=options)
    assert policy.model.text is not None


def test_smolvlm2_reads_the_instruction(models_root: Path) -> None:
    name, options = options_of("smolvlm2", models_root)
    policy = make_policy(backbone=name, backbone_options=options).eval()
    assert policy.model.text is None
    image = torch.rand(1, 3, 40, 48).expand(3, -1, -1, -1)
    tokens = policy.model.backbone(image, ["catch the ball", "catch the cube", "catch the ball"])
    assert (tokens[0] - tokens[1]).abs().max() > 1e-4
    torch.testing.assert_close(tokens[0], tokens[2])


@pytest.mark.parametrize("case", ["dinov2", "siglip", "smolvlm2"])
def test_training_starts_from_published_weights_and_a_checkpoint_carries_its_own(
    case: str, models_root: Path, tmp_path: Path
) -> None:
    name, options = options_of(case, models_root)
    policy = make_policy(backbone=name, backbone_options=options)
    random = make_policy(backbone=name, backbone_options={**options, "pretrained": False})
    part = "vlm" if case == "smolvlm2" else "tower"
    weight = {id(p): next(getattr(p.model.backbone, part).parameters()) for p in (policy, random)}
    assert (weight[id(policy)] - weight[id(random)]).abs().max() > 1e-4
    batch = make_batch(policy)
    chunk = policy.predict_action_chunk(batch)
    policy.save_pretrained(tmp_path)
    opened = TrackerPolicy.from_pretrained(tmp_path)
    torch.testing.assert_close(opened.predict_action_chunk(batch), chunk, rtol=0, atol=0)


@pytest.mark.parametrize("case", ["dinov2", "siglip", "smolvlm2"])
@pytest.mark.parametrize("freeze", [True, False])
def test_frozen_towers_get_no_gradient(case: str, freeze: bool, models_root: Path) -> None:
    name, options = options_of(case, models_root, freeze=freeze)
    policy = make_policy(backbone=name, backbone_options=options, n_obs_frames=0)
    backbone = policy.model.backbone.train()
    backbone(torch.rand(2, 3, 32, 32), ["catch", "drop"]).square().sum().backward()
    tower = getattr(backbone, "vlm", None) or backbone.tower
    assert any(p.grad is not None for p in tower.parameters()) == (not freeze)
    assert tower.training == (not freeze)
    assert backbone.project.weight.grad is not None


def test_a_keypoint_finds_a_bright_pixel() -> None:
    tokens = KeypointTokens(channels=1, n_keypoints=1, width=WIDTH)
    tokens.heatmaps.weight.data.fill_(50.0)
    inputs: list[torch.Tensor] = []
    tokens.token.register_forward_pre_hook(lambda _, args: inputs.append(args[0]))
    features = torch.zeros(1, 1, 8, 10)
    features[0, 0, 2, 7] = 1.0
    tokens(features)
    what, x, y = inputs[0][0, 0, :3].tolist()
    assert (what, x, y) == pytest.approx((1.0, 0.5, -0.375), abs=1e-3)  # column 7 of 10, row 2 of 8


def test_the_pixel_grid_is_centred() -> None:
    grid = pixel_grid(4, 6, torch.device("cpu"))
    torch.testing.assert_close(grid.mean(0), torch.zeros(2))
    torch.testing.assert_close(grid[1] - grid[0], torch.tensor([1 / 3, 0.0]))


def test_patches_are_pooled_and_class_tokens_kept() -> None:
    features = torch.arange(17.0)[None, :, None]  # a class token and 4 x 4 patches
    assert pool_patches(features, 2).flatten().tolist() == [0.0, 3.5, 5.5, 11.5, 13.5]
