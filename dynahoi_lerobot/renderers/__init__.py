"""Renderers of a batch of worlds, one file each."""

from dynahoi_lerobot.renderers.base import RENDERERS, Renderer

__all__ = ["RENDERERS", "Renderer"]
