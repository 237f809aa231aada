"""Small YAML files from anyone, read strictly: no aliases, no repeated keys, bounded size and depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

MAX_BYTES = 65_536
MAX_DEPTH = 16
"""Lists and mappings within each other; recipes have two."""


class _RefusedError(ValueError):
    """YAML features that these files may not use."""


class _PlainLoader(yaml.SafeLoader):
    """Reads YAML whose every value is written out where it stands, once."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Refuse anchors, and aliases to them, which can multiply a few lines into gigabytes; and deep nesting."""
        event = self.peek_event()
        line = event.start_mark.line + 1
        if getattr(event, "anchor", None):
            raise _RefusedError(f"anchors and aliases are not allowed, got {event.anchor!r} in line {line}")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise _RefusedError(f"values may be nested {MAX_DEPTH} deep, got more in line {line}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that appears twice, of which YAML would keep the last."""
        seen: set[str] = set()
        for key, _ in node.value:
            name = str(key.value)
            if name in seen:
                raise _RefusedError(f"key {name!r} appears again in line {key.start_mark.line + 1}")
            seen.add(name)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> Any:
    """Return what a YAML file of at most ``MAX_BYTES`` holds.

    Raises:
        ValueError: in one sentence that names the file, if it is too large, cannot be read, is not YAML in UTF-8, nests
            more than ``MAX_DEPTH`` deep, uses anchors or aliases, or repeats a key.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) > MAX_BYTES:
        raise ValueError(f"{path} has more than the {MAX_BYTES:,} bytes that are read")
    try:
        return yaml.load(content.decode(), _PlainLoader)
    except _RefusedError as error:
        raise ValueError(f"{path}: {error}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
