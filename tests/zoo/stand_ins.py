"""Tiny random models in the layout of the Hub, where the real ones are downloaded."""

from __future__ import annotations

from pathlib import Path

from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import (
    CLIPConfig,
    CLIPModel,
    PreTrainedTokenizerFast,
    SmolVLMConfig,
    SmolVLMForConditionalGeneration,
    SmolVLMImageProcessor,
    SmolVLMProcessor,
    SmolVLMVideoProcessor,
)

WORDS = ["catch", "the", "moving", "ball", "that", "is", "being", "."]
FILLERS = [f"w{i}" for i in range(300)]
"""Rare words, whose tokens may be given another meaning."""
TOWER = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2}


def save_clip(folder: Path) -> None:
    """Write a CLIP with its tokenizer; the folder's name must contain "clip"."""
    ends = {"bos_token_id": 0, "eos_token_id": 1, "pad_token_id": 1}
    text = {**TOWER, "vocab_size": 32, "max_position_embeddings": 77, **ends}
    vision = {**TOWER, "image_size": 64, "patch_size": 16}
    CLIPModel(CLIPConfig(text_config=text, vision_config=vision, projection_dim=16)).save_pretrained(folder)
    tokenizer = _words(["<|startoftext|>", "<|endoftext|>", "<unk>", *WORDS])
    ends_of_text = {"bos_token": "<|startoftext|>", "eos_token": "<|endoftext|>", "pad_token": "<|endoftext|>"}
    PreTrainedTokenizerFast(tokenizer_object=tokenizer, unk_token="<unk>", **ends_of_text).save_pretrained(folder)


def save_smolvlm(folder: Path) -> None:
    """Write a SmolVLM2 with its processor."""
    special = ["<fake_token_around_image>", "<image>", "<end_of_utterance>", "<global-img>"]
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=_words(["<pad>", "<unk>", *special, *WORDS, *FILLERS]),
        unk_token="<unk>",
        pad_token="<pad>",
        eos_token="<end_of_utterance>",
        extra_special_tokens={
            "fake_image_token": special[0],
            "image_token": special[1],
            "end_of_utterance_token": special[2],
            "global_image_token": special[3],
        },
    )
    text = {**TOWER, "vocab_size": len(tokenizer), "num_hidden_layers": 2, "num_key_value_heads": 1, "head_dim": 8}
    text |= {"model_type": "llama", "pad_token_id": 0}
    vision = {**TOWER, "image_size": 32, "patch_size": 8}
    config = SmolVLMConfig(vision_config=vision, text_config=text, scale_factor=2, image_token_id=3)
    SmolVLMForConditionalGeneration(config).save_pretrained(folder)
    small = {"longest_edge": vision["image_size"]}
    images = SmolVLMImageProcessor(size=small, max_image_size=small, do_image_splitting=False)
    length = (vision["image_size"] // vision["patch_size"]) ** 2 // config.scale_factor**2  # tokens of an image
    SmolVLMProcessor(images, tokenizer, SmolVLMVideoProcessor(), image_seq_len=length).save_pretrained(folder)


def _words(vocabulary: list[str]) -> Tokenizer:
    tokenizer = Tokenizer(models.WordLevel({word: i for i, word in enumerate(vocabulary)}, unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    return tokenizer
