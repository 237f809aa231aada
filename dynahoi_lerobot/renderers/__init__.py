"""Renderers of batched worlds, one file each; all of them agree on what is visible (see
`tests/renderers`).
"""

from dynahoi_lerobot.renderers.base import DEFAULT_RENDERER, RENDERERS, Renderer

__all__ = ["DEFAULT_RENDERER", "RENDERERS", "Renderer"]
