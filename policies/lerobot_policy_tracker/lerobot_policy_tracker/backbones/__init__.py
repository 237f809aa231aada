"""Image encoders, one per file; importing this package registers all of them."""

import sys

from ..registry import import_siblings
from .base import Backbone, backbones

import_siblings(sys.modules[__name__])

__all__ = ["Backbone", "backbones"]
