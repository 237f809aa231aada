"""Objects to catch; a function with ``@object_type`` can be played by its name."""

from dynahoi_lerobot.objects import kinds  # noqa: F401 - registers the objects
from dynahoi_lerobot.objects.base import (
    OBJECTS,
    ObjectGeometry,
    ObjectType,
    TargetObject,
    object_type,
)
from dynahoi_lerobot.objects.primitives import Primitive

__all__ = ["OBJECTS", "ObjectGeometry", "ObjectType", "Primitive", "TargetObject", "object_type"]
