"""Objects to catch, one file per kind. A new file with ``@OBJECTS.register`` is a new object everywhere."""

from dynahoi_lerobot.objects.base import OBJECTS, ObjectKind, Primitive, TargetObject

__all__ = ["OBJECTS", "ObjectKind", "Primitive", "TargetObject"]
