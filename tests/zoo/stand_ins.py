"""Tiny random models in the layout of the Hub, where the real ones are downloaded."""

import json
from pathlib import Path
from typing import Any

import torch
from diffusers import VQModel
from lerobot.policies.groot.groot_n1_7 import GR00T_N1_7_DEFAULTS, GR00TN17, GR00TN17Config
from lerobot_policy_actiontokens.openvla import OpenVLAConfig, OpenVLAForActionPrediction
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import (
    CLIPConfig,
    CLIPModel,
    PaliGemmaConfig,
    PhiConfig,
    PhiForCausalLM,
    PreTrainedTokenizerFast,
    Qwen2VLImageProcessor,
    Qwen3VLConfig,
    Qwen3VLVideoProcessor,
    SmolVLMConfig,
    SmolVLMForConditionalGeneration,
    SmolVLMImageProcessor,
    SmolVLMProcessor,
    SmolVLMVideoProcessor,
)

from tests.tools import edit_json

WORDS = ["catch", "the", "moving", "ball", "that", "is", "being", "."]
FILLERS = [f"w{i}" for i in range(300)]
"""Rare words, whose tokens may be given another meaning."""
VISION_TOKENS = ("vision_start_token_id", "vision_end_token_id")
PALIGEMMA_WORDS = ["<pad>", "<eos>", "<bos>", "<unk>", "Action", ":", "|", *WORDS, *FILLERS]
TOWER = {
    "hidden_size": 16,
    "intermediate_size": 32,
    "num_hidden_layers": 1,
    "num_attention_heads": 2,
}


def save_clip(folder: Path) -> None:
    """Write a CLIP with its tokenizer; the folder's name must contain "clip"."""
    ends = {"bos_token_id": 0, "eos_token_id": 1, "pad_token_id": 1}
    text = {**TOWER, "vocab_size": 32, "max_position_embeddings": 77, **ends}
    vision = {**TOWER, "image_size": 64, "patch_size": 16}
    CLIPModel(
        CLIPConfig(text_config=text, vision_config=vision, projection_dim=16)
    ).save_pretrained(folder)
    start = "<|startoftext|>"
    end = "<|endoftext|>"
    _tokenizer(
        [start, end, "<unk>", *WORDS], bos_token=start, eos_token=end, pad_token=end
    ).save_pretrained(folder)


def save_smolvlm(folder: Path) -> None:
    """Write a SmolVLM2 with its processor."""
    special = ["<fake_token_around_image>", "<image>", "<end_of_utterance>", "<global-img>"]
    tokenizer = _tokenizer(
        ["<pad>", "<unk>", *special, *WORDS, *FILLERS],
        pad_token="<pad>",
        eos_token="<end_of_utterance>",
        extra_special_tokens={
            "fake_image_token": special[0],
            "image_token": special[1],
            "end_of_utterance_token": special[2],
            "global_image_token": special[3],
        },
    )
    text = {
        **TOWER,
        "vocab_size": len(tokenizer),
        "num_hidden_layers": 2,
        "num_key_value_heads": 1,
        "head_dim": 8,
    }
    text |= {"model_type": "llama", "pad_token_id": 0}
    vision = {**TOWER, "image_size": 32, "patch_size": 8}
    config = SmolVLMConfig(vision_config=vision, text_config=text, scale_factor=2, image_token_id=3)
    SmolVLMForConditionalGeneration(config).save_pretrained(folder)
    small = {"longest_edge": vision["image_size"]}
    images = SmolVLMImageProcessor(size=small, max_image_size=small, do_image_splitting=False)
    length = (
        vision["image_size"] // vision["patch_size"]
    ) ** 2 // config.scale_factor**2  # tokens of an image
    SmolVLMProcessor(
        images, tokenizer, SmolVLMVideoProcessor(), image_seq_len=length
    ).save_pretrained(folder)


def save_openvla(folder: Path, size: int) -> None:
    """Write an OpenVLA for ``size`` actions in the files of the released ones, which name remote
    code.
    """
    words = ["<s>", "<unk>", "</s>", "▁", *WORDS, *FILLERS]
    _tokenizer(words, bos_token="<s>", eos_token="</s>", pad_token="<PAD>").save_pretrained(folder)
    text = {**TOWER, "model_type": "llama", "vocab_size": len(words) + 64, "num_key_value_heads": 2}
    text |= {"pad_token_id": len(words), "bos_token_id": 0, "eos_token_id": 2}
    config = OpenVLAConfig(
        timm_model_ids=["test_vit2", "test_vit"],
        image_sizes=[32, 32],
        image_seq_length=4,
        text_config=text,
        norm_stats={
            "hands": {
                "action": {
                    "q01": [-2.0] * size,
                    "q99": [4.0] * size,
                    "mask": [True] * (size - 1) + [False],
                }
            }
        },
    )
    OpenVLAForActionPrediction(config).save_pretrained(folder)
    remote = {
        "AutoConfig": "configuration_prismatic.OpenVLAConfig",
        "AutoProcessor": "x.PrismaticProcessor",
    }
    remote |= {"AutoModelForVision2Seq": "modeling_prismatic.OpenVLAForActionPrediction"}
    edit_json(folder / "config.json", auto_map=remote)
    tower = {
        "input_sizes": [3, 32, 32],
        "interpolations": "bicubic",
        "means": [0.5, 0.4, 0.3],
        "stds": [0.2, 0.3, 0.4],
    }
    pictures = {key: [value, value] for key, value in tower.items()} | {
        "image_resize_strategy": "resize-naive"
    }
    pictures |= {
        "processor_class": "PrismaticProcessor",
        "image_processor_type": "PrismaticImageProcessor",
    }
    (folder / "preprocessor_config.json").write_text(json.dumps(pictures | {"auto_map": remote}))


def save_phi(folder: Path) -> None:
    """Write a Phi with its tokenizer."""
    words = ["<|endoftext|>", "<unk>", *WORDS]
    _tokenizer(words, bos_token=words[0], eos_token=words[0]).save_pretrained(folder)
    rows = {
        "vocab_size": len(words),
        "max_position_embeddings": 512,
        "bos_token_id": 0,
        "eos_token_id": 0,
    }
    PhiForCausalLM(PhiConfig(**TOWER | {"hidden_size": 32}, **rows)).save_pretrained(folder)


def save_image_tokenizer(folder: Path) -> None:
    """Write a vector-quantized autoencoder of 16 codes, one for 2 x 2 pixels."""
    blocks = {
        "down_block_types": ["DownEncoderBlock2D"] * 2,
        "up_block_types": ["UpDecoderBlock2D"] * 2,
    }
    sizes = {
        "block_out_channels": [8, 8],
        "norm_num_groups": 4,
        "latent_channels": 4,
        "num_vq_embeddings": 16,
    }
    model = VQModel(**blocks, **sizes)
    latents = (
        model.encode(torch.rand(1, 3, 8, 8)).latents[0].flatten(1)
    )  # else one code would be nearest to all
    model.quantize.embedding.weight.data = latents.T.detach().contiguous()
    model.save_pretrained(folder)


def save_paligemma_tokenizer(folder: Path) -> None:
    """Write a tokenizer where Pi's processors look for PaliGemma's."""
    special = {"pad_token": "<pad>", "eos_token": "<eos>", "bos_token": "<bos>"}
    _tokenizer(PALIGEMMA_WORDS, **special).save_pretrained(folder)


def save_action_tokenizer(folder: Path) -> None:
    """Write a processor of actions that brings its own code, as FAST does."""
    folder.mkdir()
    (folder / "processing_coarse.py").write_text(
        (Path(__file__).parent / "processing_coarse.py").read_text()
    )
    kind = {
        "processor_class": "CoarseProcessor",
        "auto_map": {"AutoProcessor": "processing_coarse.CoarseProcessor"},
    }
    (folder / "processor_config.json").write_text(json.dumps(kind))


def shrink_paligemma(config: PaliGemmaConfig) -> PaliGemmaConfig:
    """Return the same model with a tiny vision tower, whose output fits its text model, and few
    words.
    """
    tower = {**TOWER, "projection_dim": config.text_config.hidden_size}
    for name, value in tower.items():
        setattr(config.vision_config, name, value)
    config.text_config.vocab_size = len(PALIGEMMA_WORDS)
    return config


def tiny_florence() -> dict[str, Any]:
    """Return the options of a Florence-2 with one block a stage, for X-VLA."""
    stages = {
        "embed_dim": [8, 8, 16, 16],
        "num_heads": [1, 1, 2, 2],
        "num_groups": [1, 1, 2, 2],
        "depths": [1] * 4,
    }
    text = {
        "d_model": 16,
        "encoder_layers": 1,
        "decoder_layers": 1,
        "encoder_ffn_dim": 32,
        "decoder_ffn_dim": 32,
    }
    text |= {"encoder_attention_heads": 2, "decoder_attention_heads": 2, "vocab_size": 512}
    return {"vision_config": {**stages, "projection_dim": 16}, "text_config": text}


def save_cosmos(folder: Path) -> None:
    """Write the tokenizer, processors and configuration of a Qwen3-VL, GR00T's backbone."""
    marks = [
        "<|vision_start|>",
        "<|vision_end|>",
        "<|image_pad|>",
        "<|video_pad|>",
        "<|im_start|>",
        "<|im_end|>",
    ]
    tokenizer = _tokenizer(
        ["<pad>", "<unk>", *marks, "user", *WORDS],
        pad_token="<pad>",
        eos_token="<|im_end|>",
        extra_special_tokens={mark.strip("<|>") + "_token": mark for mark in marks},
    )
    image = "<|vision_start|><|image_pad|><|vision_end|>"
    part = "{% if part['type'] == 'image' %}" + image + "{% else %}{{ part['text'] }}{% endif %}"
    message = (
        "<|im_start|>user {% for part in message['content'] %}" + part + "{% endfor %}<|im_end|>"
    )
    tokenizer.chat_template = "{% for message in messages %}" + message + "{% endfor %}"
    tokenizer.save_pretrained(folder)
    patches = {"patch_size": 16, "temporal_patch_size": 2, "merge_size": 2}
    Qwen2VLImageProcessor(**patches).save_pretrained(folder)
    Qwen3VLVideoProcessor(**patches).save_pretrained(folder)
    ids = {
        name: tokenizer.convert_tokens_to_ids(f"<|{name.removesuffix('_token_id')}|>")
        for name in VISION_TOKENS
    }
    ids |= {"image_token_id": tokenizer.convert_tokens_to_ids("<|image_pad|>")}
    ids |= {"video_token_id": tokenizer.convert_tokens_to_ids("<|video_pad|>")}
    text = {**TOWER, "vocab_size": len(tokenizer), "num_key_value_heads": 1, "head_dim": 16}
    text |= {
        "rope_parameters": {"rope_type": "default", "mrope_section": [4, 2, 2], "rope_theta": 1e4}
    }
    vision = {
        "hidden_size": 16,
        "intermediate_size": 32,
        "depth": 1,
        "num_heads": 2,
        "out_hidden_size": 16,
    }
    vision |= {"patch_size": 16, "num_position_embeddings": 64, "deepstack_visual_indexes": [0]}
    Qwen3VLConfig(text_config=text, vision_config=vision, **ids).save_pretrained(folder)


def save_groot(folder: Path, backbone: str) -> None:
    """Write a GR00T N1.7 over the backbone that ``save_cosmos`` wrote at the path ``backbone``."""
    diffusion = {
        **GR00T_N1_7_DEFAULTS["diffusion_model_cfg"],
        "num_layers": 2,
        "num_attention_heads": 2,
    }
    attention = {
        **GR00T_N1_7_DEFAULTS["vl_self_attention_cfg"],
        "num_layers": 1,
        "num_attention_heads": 2,
    }
    config = GR00TN17Config(
        model_name=backbone,
        select_layer=1,
        backbone_embedding_dim=16,
        hidden_size=16,
        input_embedding_dim=16,
        action_horizon=16,
        diffusion_model_cfg={**diffusion, "attention_head_dim": 8, "output_dim": 16},
        vl_self_attention_cfg={**attention, "attention_head_dim": 8},
        num_inference_timesteps=2,
        dtype="float32",
        model_dtype="float32",
    )
    GR00TN17(config, load_backbone_weights=False).save_pretrained(folder)


def _tokenizer(words: list[str], **special: Any) -> PreTrainedTokenizerFast:
    """Return one that knows some words, of which some are special."""
    tokenizer = Tokenizer(
        models.WordLevel({word: i for i, word in enumerate(words)}, unk_token="<unk>")
    )
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    return PreTrainedTokenizerFast(tokenizer_object=tokenizer, unk_token="<unk>", **special)
