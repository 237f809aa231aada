"""Dataclasses within dataclasses, of which people see flat names: command-line options, the keys of
a YAML file, LeRobot's ``--env.capture``.
"""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, get_type_hints


def field_names(cls: type) -> list[str]:
    """Return the names of the fields of a dataclass and of those within it, the inner ones
    first.
    """
    inner = _inner(cls)
    nested = [name for part in inner.values() for name in field_names(part)]
    return nested + [entry.name for entry in dataclasses.fields(cls) if entry.name not in inner]


def marked(cls: type, mark: str) -> list[str]:
    """Return those ``field_names`` whose metadata have a mark."""
    names = [name for part in _inner(cls).values() for name in marked(part, mark)]
    return names + [entry.name for entry in dataclasses.fields(cls) if entry.metadata.get(mark)]


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


def nested(cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return flat ``values`` as a dictionary that is nested as the dataclass is; names that no
    field has stay outside.
    """
    tree = dict(values)
    for name, part in _inner(cls).items():
        own = {key: tree.pop(key) for key in field_names(part) if key in tree}
        if own:
            tree[name] = nested(part, own)
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


def _inner(cls: type) -> dict[str, type]:
    """The dataclasses within a dataclass, by the names of their fields."""
    hints = get_type_hints(cls)
    return {
        entry.name: hints[entry.name]
        for entry in dataclasses.fields(cls)
        if dataclasses.is_dataclass(hints[entry.name])
    }
