"""Reading files that somebody else may have written.

Everything here raises `ReadError` alone, in one sentence with the path and the reason. Types are
checked by pydantic, strictly: no number becomes a text, and no text a number.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import stat
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np
import yaml

from dynahoi_lerobot.core.escaping import shortened

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pydantic import TypeAdapter, ValidationError

ROWS_AT_ONCE = 64
"""Rows that are made Python's own objects together."""


class ReadError(ValueError):
    """A file that cannot be read or has the wrong contents; the message is one sentence."""


class LeftOut(Warning):
    """A part, such as a column or a plugin, is left out and the rest is used; the message is one
    sentence.
    """


@contextmanager
def reading(path: Path, *others: type[Exception]) -> Iterator[None]:
    """Raise whatever a reader raises as a `ReadError` that names the file, or one in the folder,
    but for ``others``.
    """
    try:
        yield
    except (ReadError, *others):
        raise
    except Exception as error:  # a damaged file makes every library raise something else
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        # a number where the file was open, or PyAV's function
        named = getattr(error, "filename", None)
        file = named if isinstance(named, str) and os.sep in named else path
        raise ReadError(f"{file} cannot be read: {shortened(reason, 300)}") from error


@contextmanager
def opened(path: Path) -> Iterator[io.BufferedReader]:
    """Open a regular file, or the one that a link leads to; nothing else is waited for."""
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    with reading(path), open(os.open(path, flags), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ReadError(f"{path} cannot be read: it is no regular file")
        yield file


def regular(path: Path) -> Path:
    """Return where a file that ``opened`` opens lies, without links, for a library that opens it
    itself.
    """
    with opened(path):
        return Path(os.path.realpath(path))


def inside(folder: Path, name: object) -> Path:
    """Return the path of a file that a file in ``folder`` names; it must lie there, or in the Hub's
    cache of it.
    """
    with reading(folder):
        root = Path(os.path.realpath(folder))
        blobs = [parent.parent / "blobs" for parent in root.parents if parent.name == "snapshots"]
        path = (
            Path(os.path.realpath(root / name))
            if isinstance(name, str) and "\0" not in name
            else root
        )
        lexical = Path(os.path.normpath(root / str(name)))
        if (
            path == root
            or not lexical.is_relative_to(root)
            or not any(map(path.is_relative_to, [root, *blobs]))
        ):
            raise ReadError(f"{folder} names {name!r}, which is not inside it")
        return lexical


def read_bytes(path: Path) -> bytes:
    """Return the content of a file."""
    with opened(path) as file:
        return file.read()


def read_text(path: Path) -> str:
    """Return the content of a file in UTF-8."""
    with reading(path):
        return read_bytes(path).decode()


def sha256(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal."""
    with opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# -- JSON and YAML ---------------------------------------------------------------------------------


def read_json(path: Path) -> Any:
    """Return the value in a JSON file: finite numbers, and no key twice in one object."""
    with reading(path):
        return json.loads(
            read_text(path),
            object_pairs_hook=_object,
            parse_float=_finite,
            parse_constant=_finite,
        )


def read_object(path: Path, types: Mapping[str, Any] = {}) -> dict[str, Any]:
    """Return the object that a JSON file holds, in which the keys of ``types`` have values of these
    types.
    """
    with reading(path):
        content = validated(dict[str, Any], read_json(path))
        require(content, types)
        return content


def require(content: Mapping[str, Any], types: Mapping[str, Any]) -> None:
    """Raise a TypeError unless the keys of ``types`` have values of these types."""
    for name, hint in types.items():
        if name not in content:
            raise TypeError(f"it has no {name!r}")
        validated(hint, content[name], name)


def require_schema(path: Path, content: Mapping[str, Any], schema: int, remedy: str) -> None:
    """Raise a ReadError, which ends in ``remedy``, unless what a file holds is of the ``schema``
    that is read here.
    """
    stored = content.get("schema")
    if type(stored) is not int or stored != schema:
        version = f"schema {stored!r:.40}" if "schema" in content else "no schema"
        raise ReadError(f"{path} has {version}, and this version reads schema {schema}; {remedy}")


def validated(hint: Any, value: Any, name: str = "") -> Any:
    """Return a value of JSON as a value of a type: a dataclass, a tuple, an enumeration.

    Keys that a dataclass has no field for are ignored: another version may have written them.

    Args:
        hint: the type.
        value: as JSON holds it.
        name: of the value, for the message.

    Raises:
        TypeError: naming the first key whose value is of another type.
        ValueError: what the constructor of a dataclass says of a value.
    """
    from pydantic import ValidationError

    try:
        return _adapter(hint).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        raise _in_one_sentence(error, name) from error


@cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(hint)


def _in_one_sentence(error: ValidationError, name: str) -> Exception:
    """Return an error that names the first wrong key, the value received and the one allowed."""
    first = error.errors(include_url=False)[0]
    path = [name, *first["loc"]] if name else list(first["loc"])
    # the innermost key and places in it: people write the keys of nested dataclasses flat
    keys = [place for place, part in enumerate(path) if isinstance(part, str)]
    key = ".".join(map(str, path[keys[-1] if keys else 0 :])) or "it"
    if first["type"] == "value_error":
        return ValueError(first["msg"].removeprefix("Value error, "))
    if first["type"] == "missing":
        return TypeError(f"it has no {key!r}")
    allowed = first["msg"].replace("Input should be", "must be", 1).replace("valid array", "list")
    return TypeError(f"{key} {allowed}, got {first['input']!r:.80}")


def decoded[T](kind: type[T], values: Any) -> T:
    """Return a dataclass of values that a person has written, in YAML or on a command line.

    Raises:
        TypeError, ValueError: for a key that no field has, or as `validated`.
    """
    _refuse_unknown(kind, values)
    return validated(kind, values)


def _refuse_unknown(kind: type, values: Any) -> None:
    hints = get_type_hints(kind)
    for name, value in values.items() if isinstance(values, dict) else ():
        if name not in hints:
            raise ValueError(f"{kind.__name__} has no {name!r}; its fields: {', '.join(hints)}")
        if is_dataclass(hints[name]):
            _refuse_unknown(hints[name], value)  # type: ignore[arg-type]


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a key that appears twice, of which JSON's readers keep the first or the last."""
    values: dict[str, Any] = {}
    for key, value in pairs:
        if key in values:
            raise ValueError(f"key {key!r:.80} appears again")
        values[key] = value
    return values


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"it holds the number {text[:40]}")
    return value


class _Loader(yaml.SafeLoader):
    """Refuses a key that appears twice, of which YAML would keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if str(key.value) in seen:
                raise yaml.YAMLError(
                    f"key {key.value!r} appears again in line {key.start_mark.line + 1}"
                )
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)


# YAML 1.1 takes 2e-3, which has no dot, for a text
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


def parsed_yaml(text: str) -> Any:
    """Return the value of a text in YAML; raises YAMLError."""
    return yaml.load(text, _Loader)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds; nothing but comments is an empty one."""
    with reading(path):
        values = parsed_yaml(read_text(path))
        if not isinstance(values, dict | None):
            raise TypeError(f"it must map keys to values, got a {type(values).__name__}")
        return values or {}


# -- arrays and tables -----------------------------------------------------------------------------


def read_arrays(path: Path, names: Collection[str]) -> dict[str, np.ndarray]:
    """Return some arrays of numbers of an npz file."""
    with opened(path) as file, np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in names}
        for name, array in arrays.items():
            if array.dtype.kind not in "biuf":
                raise ValueError(f"{name} must hold numbers, got the type {array.dtype}")
        return arrays


def tensor_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Return the shape of every tensor of a safetensors file by name, from its header."""
    from safetensors import safe_open

    with reading(path), safe_open(regular(path), "numpy") as tensors:
        names = tensors.keys()  # no mapping
        return {name: tuple(tensors.get_slice(name).get_shape()) for name in names}


def open_table(path: Path) -> pq.ParquetFile:
    """Open a Parquet file whose columns have different names."""
    import pyarrow.parquet as pq

    with reading(path):
        file = pq.ParquetFile(regular(path))
        for name, following in pairwise(sorted(file.schema_arrow.names)):
            if name == following:
                raise ValueError(f"its column {name} appears again")
        return file


def read_table(path: Path, columns: Collection[str] | None = None) -> pa.Table:
    """Return a Parquet file, or some columns of it."""
    with reading(path), open_table(path) as file:
        names = file.schema_arrow.names if columns is None else list(columns)
        _require_columns(file, names)
        # read_table would take more than twice the memory where there are many row groups
        return file.read(names).select(names)


def read_rows(path: Path, schema: pa.Schema) -> Iterator[dict[str, Any]]:
    """Yield the rows of a Parquet file, its columns of a schema in their types; a few at a time are
    in memory.
    """
    import pyarrow as pa

    with reading(path), open_table(path) as file:
        _require_columns(file, schema.names)
        for batch in file.iter_batches(ROWS_AT_ONCE, columns=schema.names):
            columns = [_column(batch, field) for field in schema]
            yield from pa.RecordBatch.from_arrays(columns, schema=schema).to_pylist()


def _require_columns(file: pq.ParquetFile, names: Collection[str]) -> None:
    missing = sorted(set(names) - set(file.schema_arrow.names))
    if missing:
        raise ValueError(f"it has no column {missing[0]!r}")


def _column(batch: pa.RecordBatch, field: pa.Field) -> pa.Array:
    """Return a column in the type of a field; ValueError if its values do not fit."""
    column = batch[field.name]
    try:
        return column.cast(field.type)
    except (ValueError, NotImplementedError) as error:
        raise ValueError(
            f"its column {field.name} is of type {column.type}; it must be {field.type}"
        ) from error
