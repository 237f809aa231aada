"""OpenVLA as an image-text model of `transformers`, with the names of its checkpoints' weights."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from transformers import AutoModelForCausalLM, GenerationMixin, PreTrainedModel
from transformers.modeling_outputs import CausalLMOutputWithPast

from .configuration import OpenVLAConfig


class OpenVLAForActionPrediction(PreTrainedModel, GenerationMixin):
    """A language model that reads an image's patches where its prompt holds ``config.image_token_id``.

    Args:
        config: Its sizes.

    Raises:
        ImportError: Without `timm`.
    """

    config_class = OpenVLAConfig
    base_model_prefix = "model"
    input_modalities = ("image", "text")
    supports_gradient_checkpointing = True
    _supports_sdpa = True
    _supports_flash_attn = True
    _no_split_modules: ClassVar[list[str]] = ["LlamaDecoderLayer"]

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__(config)
        self.vision_backbone = VisionBackbone(config)
        self.language_model = AutoModelForCausalLM.from_config(config.text_config)
        self.projector = Projector(
            self.vision_backbone.width, config.text_config.hidden_size, config.use_fused_vision_backbone
        )
        self.post_init()

    def get_input_embeddings(self) -> nn.Module:
        """Return the language model's."""
        return self.language_model.get_input_embeddings()

    def get_output_embeddings(self) -> nn.Module:
        """Return the language model's."""
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
            input_ids: (B, L), with as many image tokens as there are patches, if an image is given.
            pixel_values: (B, 3 or 6, H, W), what the towers see one after the other, normalised.
            attention_mask: (B, L), 0 where there is padding.
            **kwargs: What else the language model knows: position_ids, past_key_values, labels, ...

        Raises:
            ValueError: If the towers see another number of patches than the config says.
        """
        if pixel_values is None:
            return self.language_model(input_ids=input_ids, attention_mask=attention_mask, **kwargs)
        embeddings = self.get_input_embeddings()(input_ids)  # (B, L, D)
        patches = self.projector(self.vision_backbone(pixel_values))  # (B, P, D)
        if patches.shape[1] != self.config.image_seq_length:
            raise ValueError(f"There are {patches.shape[1]} patches, but must be {self.config.image_seq_length}.")
        here = (input_ids == self.config.image_token_id).unsqueeze(-1)  # (B, L, 1)
        embeddings = embeddings.masked_scatter(here, patches.to(embeddings.dtype))
        return self.language_model(inputs_embeds=embeddings, attention_mask=attention_mask, **kwargs)

    def prepare_inputs_for_generation(
        self, *args: Any, pixel_values: Tensor | None = None, is_first_iteration: bool = False, **kwargs: Any
    ) -> dict[str, Any]:
        """Show the image once; later tokens find it in the cache."""
        inputs = super().prepare_inputs_for_generation(*args, is_first_iteration=is_first_iteration, **kwargs)
        if is_first_iteration or not kwargs.get("use_cache", True):
            inputs["pixel_values"] = pixel_values
        return inputs

    def _init_weights(self, module: nn.Module) -> None:
        """Leave the towers as `timm` makes them; the rest as `transformers` does."""
        if not isinstance(module, Scale):
            super()._init_weights(module)


class VisionBackbone(nn.Module):
    """Features of the second-to-last layer of every tower, side by side, one per patch."""

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__()
        towers = [
            _tower(name, size, activation)
            for name, size, activation in zip(
                config.timm_model_ids, config.image_sizes, config.timm_override_act_layers, strict=True
            )
        ]
        self.featurizer = towers[0]
        if config.use_fused_vision_backbone:
            self.fused_featurizer = towers[1]
        self.width = sum(tower.embed_dim for tower in towers)

    def forward(self, pixel_values: Tensor) -> Tensor:
        """Return (B, P, width) for (B, 3 per tower, H, W)."""
        towers = list(self.children())
        seen = pixel_values.split(3, dim=1)
        features = [
            tower.get_intermediate_layers(image, n={len(tower.blocks) - 2})[0]
            for tower, image in zip(towers, seen, strict=True)
        ]
        return torch.cat(features, dim=2)


class Projector(nn.Module):
    """From features of the vision towers to embeddings of the language model."""

    def __init__(self, vision: int, text: int, fused: bool) -> None:
        super().__init__()
        self.fc1 = nn.Linear(vision, 4 * vision if fused else text)
        self.fc2 = nn.Linear(4 * vision if fused else text, text)
        if fused:
            self.fc3 = nn.Linear(text, text)

    def forward(self, features: Tensor) -> Tensor:
        """Return (B, P, text) for (B, P, vision)."""
        first, *others = self.children()
        features = first(features)
        for layer in others:
            features = layer(nn.functional.gelu(features))
        return features


class Scale(nn.Module):
    """`timm`'s LayerScale under the name that OpenVLA's checkpoints give its weights."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale_factor = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        """Return every channel times its factor."""
        return x * self.scale_factor


def _tower(name: str, size: int, activation: str | None) -> nn.Module:
    import timm
    from timm.layers.layer_scale import LayerScale

    tower = timm.create_model(name, pretrained=False, num_classes=0, img_size=size, act_layer=activation)
    for parent in list(tower.modules()):
        for child, module in list(parent.named_children()):
            if isinstance(module, LayerScale):
                setattr(parent, child, Scale(len(module.gamma)))
    return tower
