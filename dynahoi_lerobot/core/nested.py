"""Dataclasses within dataclasses, of which people see flat names: command-line options, the keys of
a YAML file, LeRobot's ``--env.capture``.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from typing import Any


def leaves(cls: Any) -> Iterator[tuple[type, dataclasses.Field[Any]]]:
    """Yield the fields of a dataclass and of those within it, the inner ones first, each after the
    class that has it; a field that holds a dataclass is none of them.
    """
    for entry in dataclasses.fields(cls):
        if dataclasses.is_dataclass(entry.type):
            yield from leaves(entry.type)
    for entry in dataclasses.fields(cls):
        if not dataclasses.is_dataclass(entry.type):
            yield cls, entry


def field_names(cls: Any) -> list[str]:
    """Return the names of the ``leaves``."""
    return [entry.name for _, entry in leaves(cls)]


def changed[T](config: T, values: Mapping[str, Any]) -> T:
    """Return a dataclass with other values in some of its fields, or in fields of those within it.

    Raises:
        ValueError: for a name that no field has, or as the constructors.
    """
    cls: Any = type(config)
    unknown = values.keys() - set(field_names(cls))
    if unknown:
        allowed = ", ".join(field_names(cls))
        raise ValueError(f"{cls.__name__} has no {min(unknown)!r}; its fields: {allowed}")
    changes = {}
    for entry in dataclasses.fields(cls):
        old = getattr(config, entry.name)
        if dataclasses.is_dataclass(old):
            own = set(field_names(type(old)))
            told = {name: value for name, value in values.items() if name in own}
            if told:
                changes[entry.name] = changed(old, told)
        elif entry.name in values:
            value = values[entry.name]
            changes[entry.name] = tuple(value) if isinstance(value, list) else value
    return dataclasses.replace(config, **changes)  # type: ignore[type-var]


def as_json(config: Any) -> dict[str, Any]:
    """Return the values of a dataclass and of those within it, as JSON holds them: lists for
    tuples.
    """
    values = dataclasses.asdict(config)
    return json.loads(json.dumps(values))


def nested(cls: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return flat ``values`` as a dictionary that is nested as the dataclass is; names that no
    field has stay outside.
    """
    tree = dict(values)
    for entry in dataclasses.fields(cls):
        if dataclasses.is_dataclass(entry.type):
            names = field_names(entry.type)
            own = {key: tree.pop(key) for key in names if key in tree}
            if own:
                tree[entry.name] = nested(entry.type, own)
    return tree


def flat(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a dictionary and of those within it, at one level."""
    entries: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            entries |= flat(value)
        else:
            entries[name] = value
    return entries
