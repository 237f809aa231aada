"""OpenVLA's checkpoints (Kim et al., 2024) without their remote code: configuration, model and
processor.

Importing this registers them with `transformers`.
"""

import json
import re
from collections import OrderedDict
from pathlib import Path
from typing import Any, ClassVar, Self, cast

import torch
from PIL.Image import Image
from torch import Tensor, nn
from torchvision.transforms import InterpolationMode
from torchvision.transforms import functional as tvf
from transformers import (
    CONFIG_MAPPING,
    AutoConfig,
    AutoModelForCausalLM,
    AutoModelForImageTextToText,
    AutoProcessor,
    AutoTokenizer,
    GenerationMixin,
    PreTrainedConfig,
    PreTrainedModel,
)
from transformers.modeling_outputs import CausalLMOutputWithPast
from transformers.utils.hub import cached_file


class OpenVLAConfig(PreTrainedConfig):
    """One or two vision towers of `timm`, a projector and a language model (OpenVLA, Section 3.1).

    Attributes:
        timm_model_ids: names of the vision towers in `timm`.
        timm_override_act_layers: activation of each tower; None uses the tower's default.
        image_sizes: side of the square input image of each tower [px].
        image_seq_length: patches of an image; by default derived from the first tower's name.
        use_fused_vision_backbone: whether there are two towers, whose features are concatenated per
            patch.
        text_config: config of the language model.
        norm_stats: ``{dataset: {"action": {"q01": [...], "q99": [...], "mask": [...]}}}``, the
            statistics by which actions were normalized in training.
    """

    model_type = "openvla"
    sub_configs: ClassVar[dict[str, Any]] = {"text_config": AutoConfig}

    timm_model_ids: list[str] | None = None
    timm_override_act_layers: list[str | None] | None = None
    image_sizes: list[int] | None = None
    image_seq_length: int | None = None
    use_fused_vision_backbone: bool = True
    text_config: dict[str, Any] | PreTrainedConfig | None = None
    norm_stats: dict[str, Any] | None = None
    tie_word_embeddings: bool = False

    def __post_init__(self, **kwargs: Any) -> None:
        self.timm_model_ids = self.timm_model_ids or [
            "vit_large_patch14_reg4_dinov2.lvd142m",
            "vit_so400m_patch14_siglip_224",
        ]
        self.timm_override_act_layers = self.timm_override_act_layers or [
            None for _ in self.timm_model_ids
        ]
        self.image_sizes = self.image_sizes or [224] * len(self.timm_model_ids)
        if self.image_seq_length is None:
            self.image_seq_length = _patches(self.timm_model_ids[0], self.image_sizes[0])
        text = self.text_config or {}
        if isinstance(text, dict):
            self.text_config = CONFIG_MAPPING[text.get("model_type", "llama")](**text)
        super().__post_init__(**kwargs)

    @property
    def image_token_id(self) -> int:
        """Id of the placeholder of an image patch, which no text contains."""
        return cast(Any, self.text_config).vocab_size - 1


def _patches(tower: str, size: int) -> int:
    """Return the number of patches of a ``size`` x ``size`` px image, from the name of a tower of
    `timm`.
    """
    patch = re.search(r"patch(\d+)", tower)
    if patch is None:
        raise ValueError(
            f"the vision tower is {tower!r}, a name without 'patch<size>': set image_seq_length "
            f"in the config."
        )
    return (size // int(patch[1])) ** 2


class OpenVLAForActionPrediction(PreTrainedModel, GenerationMixin):
    """A language model whose input embeddings at ``config.image_token_id`` are replaced by
    projected image patches.

    Args:
        config: sizes of its parts.

    Raises:
        ImportError: if `timm` is not installed.
    """

    config_class = OpenVLAConfig
    base_model_prefix = "model"
    input_modalities: ClassVar[Any] = ("image", "text")
    supports_gradient_checkpointing = True
    _supports_sdpa = True
    _supports_flash_attn = True
    _no_split_modules: ClassVar[list[str]] = ["LlamaDecoderLayer"]

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__(config)
        self.vision_backbone = VisionBackbone(config)
        text_config: Any = config.text_config
        self.language_model = AutoModelForCausalLM.from_config(text_config)
        fused = config.use_fused_vision_backbone
        self.projector = _projector(self.vision_backbone.width, text_config.hidden_size, fused)
        self.post_init()

    def get_input_embeddings(self) -> nn.Module:
        """Return the embeddings of the language model."""
        return self.language_model.get_input_embeddings()

    def get_output_embeddings(self) -> nn.Module:
        """Return the embeddings of the language model."""
        return self.language_model.get_output_embeddings()

    def forward(
        self,
        input_ids: Tensor | None = None,
        pixel_values: Tensor | None = None,
        attention_mask: Tensor | None = None,
        **kwargs: Any,
    ) -> CausalLMOutputWithPast:
        """Return the logits of the next tokens.

        Args:
            input_ids: ``(B, L)``, with one image token per patch if an image is given.
            pixel_values: ``(B, 3 or 6, H, W)``, the normalized images of the towers, concatenated
                along channels.
            attention_mask: ``(B, L)``, 0 where there is padding.
            **kwargs: other inputs of the language model: position_ids, past_key_values, labels, ...

        Raises:
            ValueError: if the towers return another number of patches than
                ``config.image_seq_length``.
        """
        if pixel_values is None:
            return self.language_model(input_ids=input_ids, attention_mask=attention_mask, **kwargs)
        embeddings = self.get_input_embeddings()(input_ids)  # (B, L, D)
        patches = self.projector(self.vision_backbone(pixel_values))  # (B, P, D)
        if patches.shape[1] != self.config.image_seq_length:
            raise ValueError(
                f"there are {patches.shape[1]} patches, but must be {self.config.image_seq_length}."
            )
        is_image = (input_ids == self.config.image_token_id).unsqueeze(-1)  # (B, L, 1)
        embeddings = embeddings.masked_scatter(is_image, patches.to(embeddings.dtype))
        return self.language_model(
            inputs_embeds=embeddings, attention_mask=attention_mask, **kwargs
        )

    def prepare_inputs_for_generation(
        self,
        *args: Any,
        pixel_values: Tensor | None = None,
        is_first_iteration: bool = False,
        **kwargs: Any,
    ) -> dict[str, Any]:
        """Pass the image in the first step only: later steps find its keys and values in the
        cache.
        """
        parent: Any = super()
        inputs = parent.prepare_inputs_for_generation(
            *args, is_first_iteration=is_first_iteration, **kwargs
        )
        if is_first_iteration or not kwargs.get("use_cache", True):
            inputs["pixel_values"] = pixel_values
        return inputs


class VisionBackbone(nn.Module):
    """The features of the second-to-last layer of every tower, concatenated per patch.

    Args:
        config: config of the whole model.
    """

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__()
        names = config.timm_model_ids or []
        sizes = config.image_sizes or []
        activations = config.timm_override_act_layers or []
        towers = [_tower(*options) for options in zip(names, sizes, activations, strict=True)]
        self.featurizer = towers[0]
        if config.use_fused_vision_backbone:
            self.fused_featurizer = towers[1]
        self.width = sum(int(tower.embed_dim) for tower in towers)

    def forward(self, pixel_values: Tensor) -> Tensor:
        """Map pixels ``(B, 3 per tower, H, W)`` to features ``(B, P, width)``."""
        towers: list[Any] = list(self.children())
        images = pixel_values.split(3, dim=1)
        features = [
            tower.get_intermediate_layers(image, n={len(tower.blocks) - 2})[0]
            for tower, image in zip(towers, images, strict=True)
        ]
        return torch.cat(features, dim=2)


class Scale(nn.Module):
    """`timm`'s LayerScale with the parameter name of OpenVLA's checkpoints.

    Args:
        width: number of channels.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale_factor = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        """Scale each channel, ``(..., width) -> (..., width)``."""
        return x * self.scale_factor


def _projector(vision: int, text: int, fused: bool) -> nn.Sequential:
    """Return the MLP from features of size ``vision`` to embeddings of size ``text``; three layers
    for two towers.
    """
    wide = 4 * vision if fused else text
    layers: dict[str, nn.Module] = {
        "fc1": nn.Linear(vision, wide),
        "gelu1": nn.GELU(),
        "fc2": nn.Linear(wide, text),
    }
    if fused:
        layers |= {"gelu2": nn.GELU(), "fc3": nn.Linear(text, text)}
    return nn.Sequential(OrderedDict(layers))


def _tower(name: str, size: int, activation: str | None) -> Any:
    import timm
    from timm.layers.layer_scale import LayerScale

    tower = timm.create_model(
        name, pretrained=False, num_classes=0, img_size=size, act_layer=activation
    )
    for parent in list(tower.modules()):
        for child, module in list(parent.named_children()):
            if isinstance(module, LayerScale):
                setattr(parent, child, Scale(len(module.gamma)))
    return tower


EMPTY = "▁"
"""The token between "Out:" and the first action in OpenVLA's training data."""


class PrismaticProcessor:
    """Converts images and prompts into model inputs; the class name is the one that OpenVLA's
    checkpoints ask for.

    Args:
        config: config of the model.
        tokenizer: tokenizer of its language model.
        image_settings: `preprocessor_config.json` of the checkpoint: ``input_sizes``,
            ``interpolations``, ``means`` and ``stds`` of every tower, and
            ``image_resize_strategy``.
    """

    image_token = "<image>"

    def __init__(
        self, config: OpenVLAConfig, tokenizer: Any, image_settings: dict[str, Any]
    ) -> None:
        self.config = config
        self.tokenizer = tokenizer
        self.image_settings = image_settings

    @classmethod
    def from_pretrained(cls, name: str | Path, **kwargs: Any) -> Self:
        """Open a checkpoint, by folder or Hub name."""
        kwargs = {
            key: value for key, value in kwargs.items() if key in ("revision", "token", "cache_dir")
        }
        settings = json.loads(
            Path(str(cached_file(name, "preprocessor_config.json", **kwargs))).read_text()
        )
        config: Any = AutoConfig.from_pretrained(name, **kwargs)
        return cls(config, AutoTokenizer.from_pretrained(name, **kwargs), settings)

    def __call__(
        self,
        images: list[list[Tensor]],
        text: list[str],
        padding: bool = True,
        return_tensors: str = "pt",
    ) -> dict[str, Tensor]:
        """Return the model's inputs.

        Args:
            images: one list per prompt, of one image ``(3, H, W)`` uint8.
            text: prompts, each of which starts with ``image_token``.
            padding: ignored: prompts are always padded, on the tokenizer's side.
            return_tensors: ignored: always "pt".

        Returns:
            ``input_ids`` and ``attention_mask``, ``(B, L)`` int64, and ``pixel_values``, ``(B, 3
            per tower, H, W)`` float32.

        Raises:
            ValueError: if an image is not square and the checkpoint does not resize naively.
        """
        del padding, return_tensors
        prompts = [self._tokens(prompt) for prompt in text]
        inputs = self.tokenizer.pad({"input_ids": prompts}, return_tensors="pt")
        pixels = torch.stack([self._pixels(image) for (image,) in images])
        return {
            "input_ids": inputs["input_ids"],
            "attention_mask": inputs["attention_mask"],
            "pixel_values": pixels,
        }

    def _tokens(self, prompt: str) -> list[int]:
        """Return the ids of the patches, the prompt and the empty token, as in training."""
        words = self.tokenizer(prompt.removeprefix(self.image_token), add_special_tokens=False)[
            "input_ids"
        ]
        empty = self.tokenizer.get_vocab().get(EMPTY)
        ending = [] if empty is None or words[-1] == empty else [empty]
        patches = [self.config.image_token_id] * (self.config.image_seq_length or 0)
        return [self.tokenizer.bos_token_id, *patches, *words, *ending]

    def _pixels(self, image: Tensor) -> Tensor:
        """Return the normalized image of every tower, ``(3 per tower, H, W)`` float32."""
        strategy = self.image_settings["image_resize_strategy"]
        if strategy != "resize-naive" and image.shape[1] != image.shape[2]:
            raise ValueError(
                f"the image is {image.shape[2]} x {image.shape[1]}, but must be square for "
                f"{strategy}."
            )
        pil_image = tvf.to_pil_image(image)
        pixels = []
        for size, interpolation, mean, std in zip(
            *(
                self.image_settings[key]
                for key in ("input_sizes", "interpolations", "means", "stds")
            ),
            strict=True,
        ):
            resized = tvf.resize(
                pil_image, size[1:], InterpolationMode(interpolation), antialias=True
            )
            pixels.append(tvf.normalize(tvf.to_tensor(cast(Image, resized)), mean, std))
        return torch.cat(pixels)


AutoConfig.register("openvla", OpenVLAConfig, exist_ok=True)
AutoModelForImageTextToText.register(OpenVLAConfig, OpenVLAForActionPrediction, exist_ok=True)
AutoProcessor.register(OpenVLAConfig, PrismaticProcessor, exist_ok=True)
