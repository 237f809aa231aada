"""Action heads, one per file; importing this package registers all of them."""

import sys

from ..registry import import_siblings
from .base import ActionHead, ActionSpec, Condition, heads

import_siblings(sys.modules[__name__])

__all__ = ["ActionHead", "ActionSpec", "Condition", "heads"]
