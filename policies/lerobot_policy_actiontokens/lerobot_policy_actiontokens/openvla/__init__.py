"""OpenVLA's checkpoints (Kim et al., 2024) without their remote code; this registers them with `transformers`."""

from transformers import AutoConfig, AutoModelForImageTextToText, AutoProcessor

from .configuration import OpenVLAConfig
from .modeling import OpenVLAForActionPrediction
from .processing import PrismaticProcessor

AutoConfig.register("openvla", OpenVLAConfig, exist_ok=True)
AutoModelForImageTextToText.register(OpenVLAConfig, OpenVLAForActionPrediction, exist_ok=True)
AutoProcessor.register(OpenVLAConfig, PrismaticProcessor, exist_ok=True)

__all__ = ["OpenVLAConfig", "OpenVLAForActionPrediction", "PrismaticProcessor"]
