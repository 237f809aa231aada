"""Objects to catch, one file each; a new file with ``@OBJECTS.register`` can be played by its name."""

from dynahoi_lerobot.objects.base import OBJECTS, ObjectGeometry, ObjectType, TargetObject
from dynahoi_lerobot.objects.primitives import Primitive

__all__ = ["OBJECTS", "ObjectGeometry", "ObjectType", "Primitive", "TargetObject"]
