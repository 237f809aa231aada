"""Action heads: each file registers one, and every file here is found without further lines."""

import sys

from ..registry import import_siblings
from .base import ActionHead, ActionSpec, Condition, heads

import_siblings(sys.modules[__name__])

__all__ = ["ActionHead", "ActionSpec", "Condition", "heads"]
