"""Renderers of a batch of worlds, one file each."""

from dynahoi_lerobot.renderers.base import DEFAULT_RENDERER, RENDERERS, Renderer

__all__ = ["DEFAULT_RENDERER", "RENDERERS", "Renderer"]
