"""OpenVLA's checkpoints: opened without remote code, read and written as their authors do, made
LeRobot policies.
"""

import json
from pathlib import Path

import pytest
import torch
from lerobot.policies.factory import make_pre_post_processors
from lerobot_policy_actiontokens import ActionTokensPolicy
from lerobot_policy_actiontokens.import_openvla import import_openvla
from lerobot_policy_actiontokens.openvla import OpenVLAForActionPrediction, PrismaticProcessor
from torch import Tensor
from torchvision.transforms import functional as tvf
from transformers import AutoModelForImageTextToText, AutoProcessor

from tests.zoo.stand_ins import WORDS, save_openvla

SIZE = 18
PATCHES = 4
CAMERA = "observation.images.ego"
PROMPT = "<image>In: catch the moving ball?\nOut: "


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("models") / "openvla"
    torch.manual_seed(0)
    save_openvla(folder, SIZE)
    return str(folder)


@pytest.fixture(scope="module")
def model(checkpoint: str) -> OpenVLAForActionPrediction:
    return AutoModelForImageTextToText.from_pretrained(checkpoint).eval()


@pytest.fixture  # of each test its own, as some change it
def processor(checkpoint: str) -> PrismaticProcessor:
    return AutoProcessor.from_pretrained(checkpoint)


@pytest.fixture(scope="module")
def imported(checkpoint: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("imported") / "policy"
    import_openvla(checkpoint, "hands", out, camera=CAMERA, image_size=32, dtype="float32")
    return out


def picture(seed: int = 0, size: int = 40) -> Tensor:
    return torch.randint(
        0, 256, (3, size, size), generator=torch.Generator().manual_seed(seed), dtype=torch.uint8
    )


def test_weights_have_the_names_of_the_released_ones(model: OpenVLAForActionPrediction) -> None:
    shapes = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    released = {
        "vision_backbone.featurizer.blocks.0.ls1.scale_factor": (64,),
        "vision_backbone.fused_featurizer.blocks.0.attn.qkv.weight": (192, 64),
        "projector.fc1.weight": (4 * 128, 128),
        "projector.fc2.weight": (16, 4 * 128),
        "projector.fc3.weight": (16, 16),
        "language_model.model.layers.0.self_attn.q_proj.weight": (16, 16),
        "language_model.lm_head.weight": (model.config.text_config.vocab_size, 16),
    }
    assert released.items() <= shapes.items()
    assert {name.split(".")[0] for name in shapes} == {name.split(".")[0] for name in released}


def test_the_prompt_is_that_of_training(
    processor: PrismaticProcessor, model: OpenVLAForActionPrediction
) -> None:
    (ids,) = processor(images=[[picture()]], text=[PROMPT])["input_ids"]
    tokenizer = processor.tokenizer
    assert ids[0] == tokenizer.bos_token_id
    assert ids[1 : 1 + PATCHES].tolist() == [model.config.image_token_id] * PATCHES
    assert model.config.image_token_id >= len(tokenizer)
    assert ids[-1] == tokenizer.convert_tokens_to_ids("▁")
    words = tokenizer.convert_ids_to_tokens(ids[1 + PATCHES : -1].tolist())
    assert [word for word in words if word in WORDS] == ["catch", "the", "moving", "ball"]


def test_each_tower_sees_its_own_normalization(processor: PrismaticProcessor) -> None:
    processor.image_settings["means"] = [[0.5, 0.4, 0.3], [0.0, 0.0, 0.0]]
    processor.image_settings["stds"] = [[0.2, 0.3, 0.4], [1.0, 1.0, 1.0]]
    (pixels,) = processor(images=[[picture()]], text=[PROMPT])["pixel_values"]
    assert pixels.shape == (6, 32, 32)
    resized = tvf.to_tensor(tvf.to_pil_image(picture()).resize((32, 32), resample=3))  # bicubic
    torch.testing.assert_close(pixels[3:], resized)
    torch.testing.assert_close(pixels[:3], tvf.normalize(resized, [0.5, 0.4, 0.3], [0.2, 0.3, 0.4]))


def test_an_image_that_would_be_cropped_is_refused(processor: PrismaticProcessor) -> None:
    processor.image_settings["image_resize_strategy"] = "letterbox"
    with pytest.raises(ValueError, match="20 x 40, but must be square for letterbox"):
        processor(images=[[picture()[:, :, :20]]], text=[PROMPT])


def test_patches_follow_the_first_token(
    processor: PrismaticProcessor, model: OpenVLAForActionPrediction
) -> None:
    """The features of both towers' second-to-last layers, projected, stand between <s> and the
    prompt.
    """
    inputs = processor(images=[[picture()]], text=[PROMPT])
    towers = model.vision_backbone.featurizer, model.vision_backbone.fused_featurizer
    seen = []
    for tower, pixels in zip(towers, inputs["pixel_values"].split(3, dim=1), strict=True):
        x = tower.norm_pre(tower._pos_embed(tower.patch_embed(pixels)))
        for block in tower.blocks[:-1]:
            x = block(x)
        seen.append(x[:, -PATCHES:])
    gelu = torch.nn.functional.gelu
    projector = model.projector
    patches = projector.fc3(gelu(projector.fc2(gelu(projector.fc1(torch.cat(seen, dim=2))))))
    text = model.get_input_embeddings()(inputs["input_ids"])
    embeddings = torch.cat([text[:, :1], patches, text[:, 1 + PATCHES :]], dim=1)
    torch.testing.assert_close(
        model(**inputs).logits, model.language_model(inputs_embeds=embeddings).logits
    )


def test_an_imported_checkpoint_acts_as_the_model_does(model, processor, imported: Path) -> None:
    """Bins count down from the tokenizer's size, and are stretched between the dataset's
    percentiles.
    """
    policy = ActionTokensPolicy.from_pretrained(imported)
    preprocess, postprocess = make_pre_post_processors(policy.config, pretrained_path=str(imported))
    image = picture(size=32)
    batch = preprocess({CAMERA: image.float() / 255, "task": "Catch the moving ball."})
    action = postprocess(policy.select_action(batch))[0]
    prompt = "<image>In: What action should the robot take to catch the moving ball?\nOut: "
    inputs = processor(images=[[image]], text=[prompt])
    vocabulary = processor.tokenizer.vocab_size
    allowed = range(vocabulary - 256, vocabulary)
    written = []
    for _ in range(SIZE):
        logits = model(**inputs).logits[0, -1, allowed.start : allowed.stop]
        written.append(allowed[int(logits.argmax())])
        inputs["input_ids"] = torch.cat([inputs["input_ids"], torch.tensor([[written[-1]]])], dim=1)
        inputs["attention_mask"] = torch.ones_like(inputs["input_ids"])
    edges = torch.linspace(-1, 1, 256)
    bins = (vocabulary - torch.tensor(written) - 1).clamp(0, 254)
    normalized = (edges[bins] + edges[bins + 1]) / 2
    expected = torch.cat([0.5 * (normalized[:-1] + 1) * (4.0 - -2.0) + -2.0, normalized[-1:]])
    torch.testing.assert_close(action, expected)


def test_an_unknown_dataset_is_named(checkpoint: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"unnorm_key is 'bridge', but .* has hands"):
        import_openvla(
            checkpoint, "bridge", tmp_path / "p", camera=CAMERA, image_size=32, dtype="float32"
        )
    assert not (tmp_path / "p").exists()


def test_towers_that_see_other_patches_are_refused(checkpoint: str, tmp_path: Path) -> None:
    config = json.loads((Path(checkpoint) / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(config | {"image_seq_length": 9}))
    model = OpenVLAForActionPrediction(
        OpenVLAForActionPrediction.config_class.from_pretrained(tmp_path)
    )
    with pytest.raises(ValueError, match="there are 4 patches, but must be 9"):
        model(
            input_ids=torch.zeros(1, 12, dtype=torch.int64), pixel_values=torch.zeros(1, 6, 32, 32)
        )
