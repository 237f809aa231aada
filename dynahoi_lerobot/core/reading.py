"""Reading what others may have written: how large a file is, and grows when it is decoded, is known
before it is.

Everything here raises `ReadError` alone, in one sentence with the path and the reason.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import stat
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import yaml

from dynahoi_lerobot.core.escaping import shortened

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

MIB, GIB = 2**20, 2**30
FILE_BYTES = 4 * GIB
"""Largest table or video."""
WEIGHTS_BYTES = 64 * GIB
TEXT_BYTES, YAML_BYTES = 32 * MIB, MIB
"""Largest JSON or other text; YAML takes a thousand times as long."""
DEPTH, VALUES, INTEGER = 64, 3 * 10**6, 2**64
"""Deepest nesting, most values and largest integer of JSON and YAML."""
TABLE_BYTES, ARRAY_BYTES = GIB, GIB // 4
"""Largest table, and arrays, in memory; arrays are copied when they are decoded and checked."""
UNQUESTIONED, GROWTH = 32 * MIB, 64
"""Arrays and tables may grow to this size [bytes], and beyond it by this factor of that of their
file."""
ROWS_AT_ONCE, ROWS_BYTES = 64, 32 * MIB
"""Rows that are made Python's own objects together, and their size before that: it grows
eightfold."""


class ReadError(ValueError):
    """A file that cannot be read, or does not hold what it should; the message is one sentence."""


class LeftOut(Warning):
    """Part of what was to be read is left out and the rest is used; the message is one sentence."""


@contextmanager
def reading(path: Path, *others: type[Exception]) -> Iterator[None]:
    """Raise whatever a reader raises as a `ReadError` that names the file, or one in the folder,
    but for ``others``.
    """
    try:
        yield
    except (ReadError, *others):
        raise
    except (
        Exception
    ) as error:  # what a damaged file makes a reader raise differs from library to library
        told = getattr(error, "strerror", None) or str(error) or type(error).__name__
        named = getattr(
            error, "filename", None
        )  # a number where the file was open, or PyAV's function
        file = named if isinstance(named, str) and os.sep in named else path
        raise ReadError(f"{file} cannot be read: {shortened(told, 300)}") from error


@contextmanager
def opened(path: Path, most: int = FILE_BYTES) -> Iterator[io.BufferedReader]:
    """Open a regular file of at most ``most`` bytes, or what a link to one leads to; nothing else
    is waited for.
    """
    with (
        reading(path),
        open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file,
    ):
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise ReadError(f"{path} cannot be read: it is no regular file")
        if status.st_size > most:
            raise ReadError(
                f"{path} cannot be read: it has {status.st_size} bytes, more than {most}"
            )
        yield file


def regular(path: Path, most: int = FILE_BYTES) -> Path:
    """Return where a file that ``opened`` opens lies, without links, for a library that opens it
    itself.
    """
    with opened(path, most):
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


def read_bytes(path: Path, most: int = TEXT_BYTES) -> bytes:
    """Return the content of a file."""
    with opened(path, most) as file:
        return file.read(most)


def read_text(path: Path, most: int = TEXT_BYTES) -> str:
    """Return the content of a file in UTF-8."""
    with reading(path):
        return read_bytes(path, most).decode()


def sha256(path: Path, most: int = WEIGHTS_BYTES) -> str:
    """Return the sha256 of a file in hexadecimal."""
    with opened(path, most) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# -- JSON and YAML ---------------------------------------------------------------------------------


def read_json(path: Path) -> Any:
    """Return what a JSON file holds, of finite numbers and Unicode text."""
    with reading(path):
        text = read_text(path)
        if sum(map(text.count, ",[{")) > VALUES:  # parsing it would take minutes
            raise ValueError(f"it holds more than {VALUES} values")
        return _plain(json.loads(text, object_pairs_hook=_object))


def read_object(path: Path, types: Mapping[str, Any] = {}) -> dict[str, Any]:
    """Return the object that a JSON file holds, in which the keys of ``types`` have values of these
    types.
    """
    with reading(path):
        if not isinstance(content := read_json(path), dict):
            raise TypeError(f"it must be a JSON object, not a {type(content).__name__}")
        require(content, types)
        return content


def require(content: Mapping[str, Any], types: Mapping[str, Any]) -> None:
    """Raise a TypeError unless the keys of ``types`` have values of these types."""
    for name, hint in types.items():
        if name not in content:
            raise TypeError(f"it has no {name!r}")
        if not fits(content[name], hint):
            told = hint.__name__ if isinstance(hint, type) and not get_args(hint) else hint
            told = str(told).replace("tuple[str, ...]", "list[str]")
            raise TypeError(f"{name} must be of type {told}, got {content[name]!r:.80}")


def fits(value: Any, hint: Any) -> bool:
    """Tell whether a value of JSON is of a type such as ``dict[str, list[int]] | None``; a bool is
    no number.

    An object is of the type of a dataclass if the values of its fields are of theirs, and a name of
    that of an enumeration if it has the name. Whatever is no type but a hint fits.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(fits(value, kind) for kind in inner)
    if origin is dict:
        return isinstance(value, dict) and all(fits(item, inner[1]) for item in value.values())
    if origin in (list, tuple, set):
        items = value if isinstance(value, list | tuple) else None
        wanted = inner if origin is tuple and inner[-1] is not ... else inner[:1] * len(items or ())
        return items is not None and len(items) == len(wanted) and all(map(fits, items, wanted))
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        needed = {
            entry.name for entry in fields(hint) if entry.default is entry.default_factory
        }  # both MISSING
        known = isinstance(value, dict) and needed <= value.keys()
        return known and all(fits(item, hints.get(name, Any)) for name, item in value.items())
    if isinstance(hint, type) and issubclass(hint, Enum):
        return isinstance(value, str) and value in hint.__members__
    kinds = {float: (int, float), None: type(None), Path: str, tuple: (list, tuple)}.get(hint, hint)
    anything = not isinstance(kinds, type | tuple) or hint in (Any, object)
    return anything or (isinstance(value, kinds) and (hint is bool or not isinstance(value, bool)))


def decoded[T](kind: type[T], values: Any) -> T:
    """Return a dataclass of values of JSON or YAML; of other types than its fields', draccus would
    make text of them.

    Raises:
        TypeError, ValueError: naming the field, or what the dataclass says of its value.
    """
    import draccus

    require({"it": values}, {"it": dict})
    _require_fields(kind, values)
    try:
        return draccus.decode(kind, values)
    except draccus.utils.DraccusException as error:
        told = error if isinstance(error, draccus.utils.DecodingError) else error.__cause__ or error
        raise ValueError(str(told)) from error


def _require_fields(kind: type, values: dict[str, Any]) -> None:
    """Refuse values that are not of the types of their fields, also of dataclasses in fields."""
    hints = get_type_hints(kind)
    for name, value in values.items():
        if name in hints and is_dataclass(hints[name]) and isinstance(value, dict):
            _require_fields(hints[name], value)
        elif name in hints:
            require(values, {name: hints[name]})


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a key that appears twice, of which JSON's readers keep the first or the last."""
    held = dict(pairs)
    if len(held) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(
            f"key {next(key for key in keys if keys.count(key) > 1)!r:.80} appears again"
        )
    return held


def _plain(content: Any) -> Any:
    """Return a tree of lists and dictionaries that is neither deep nor large when written out."""
    level, values = [content], 0
    for _ in range(DEPTH):
        for value in level:
            if isinstance(value, str):
                value.encode()
            elif isinstance(value, int | float) and not -INTEGER < value < INTEGER:
                raise ValueError(f"it holds the number {str(value)[:40]}")
        keys = [key for item in level if isinstance(item, dict) for key in item]
        inner = (
            item.values() if isinstance(item, dict) else item
            for item in level
            if isinstance(item, dict | list)
        )
        level = keys + [value for part in inner for value in part]
        values += len(level)
        if not level:
            return content
        if values > VALUES:
            raise ValueError(f"it holds more than {VALUES} values")
    raise ValueError(f"it is nested more than {DEPTH} deep")


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
    """Return what a text in YAML stands for; raises ValueError or YAMLError."""
    return _plain(yaml.load(text, _Loader))


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds; nothing but comments is an empty one."""
    with reading(path):
        values = parsed_yaml(read_text(path, YAML_BYTES))
        if not isinstance(values, dict | None):
            raise TypeError(f"it must map keys to values, got a {type(values).__name__}")
        return values or {}


# -- arrays and tables -----------------------------------------------------------------------------


def _refuse_growth(path: Path, size: int, most: int) -> None:
    """Refuse a file that takes more than ``most`` bytes in memory, or far more than on the disk."""
    most = min(most, UNQUESTIONED + GROWTH * path.stat().st_size)
    if size > most:
        raise ReadError(f"{path} cannot be read: it expands to {size} bytes or more, beyond {most}")


def read_arrays(path: Path, names: Collection[str]) -> dict[str, np.ndarray]:
    """Return some arrays of numbers of an npz file."""
    with opened(path) as file, zipfile.ZipFile(file) as archive:
        _refuse_growth(
            path, sum(archive.getinfo(f"{name}.npy").file_size for name in names), ARRAY_BYTES
        )
        return {name: _array(archive.read(f"{name}.npy")) for name in names}


def regular_zip(path: Path, most: int) -> Path:
    """Return where a zip that takes at most ``most`` bytes in memory lies, for a library that opens
    it itself.
    """
    with opened(path, most) as file, zipfile.ZipFile(file) as archive:
        _refuse_growth(path, sum(entry.file_size for entry in archive.infolist()), most)
    return regular(path, most)


def _array(content: bytes) -> np.ndarray:
    """Decode an npy file, whose header must tell the size of what follows it."""
    version = np.lib.format.read_magic(file := io.BytesIO(content))
    if version != (1, 0):
        raise ValueError(f"its arrays are of version {version} of the format, which must be (1, 0)")
    shape, _, kind = np.lib.format.read_array_header_1_0(file)
    if kind.kind not in "biuf" or math.prod(shape) * kind.itemsize != len(content) - file.tell():
        raise ValueError(
            f"an array of shape {shape} and type {kind} does not have {len(content)} bytes"
        )
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def tensor_types(path: Path) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Return type, such as ``F32``, and shape of every tensor of a safetensors file by name, from
    its header.
    """
    from safetensors import safe_open

    with reading(path), safe_open(regular(path, WEIGHTS_BYTES), "numpy") as tensors:
        slices = {name: tensors.get_slice(name) for name in tensors.keys()}  # noqa: SIM118 - no mapping
        return {
            name: (tensor.get_dtype(), tuple(tensor.get_shape())) for name, tensor in slices.items()
        }


def open_table(path: Path, columns: Collection[str] | None = None) -> pq.ParquetFile:
    """Open a Parquet file of which some columns, all by default, take at most ``TABLE_BYTES`` when
    they are decoded.
    """
    import pyarrow.parquet as pq

    with reading(path):
        file = pq.ParquetFile(regular(path))
        if len(names := sorted(file.schema_arrow.names)) > len({*names}):
            raise ValueError(
                f"its column {next(a for a, b in pairwise(names) if a == b)} appears again"
            )
        _refuse_growth(path, _decoded_bytes(file, path, columns), TABLE_BYTES)
        return file


def read_table(path: Path, columns: Collection[str] | None = None, filters: Any = None) -> pa.Table:
    """Return a Parquet file, or of it some columns, or the rows that ``filters`` of pyarrow let
    through.
    """
    import pyarrow.parquet as pq

    with reading(path):
        used = None if columns is None else {*columns, *(entry[0] for entry in filters or ())}
        with open_table(path, used) as file:
            if missing := sorted({*(used or ())} - {*file.schema_arrow.names}):
                raise ValueError(f"it has no column {missing[0]!r}")
        names = None if columns is None else list(columns)
        return pq.read_table(regular(path), columns=names, filters=filters, partitioning="")


def read_rows(path: Path, columns: Collection[str] | None = None) -> Iterator[dict[str, Any]]:
    """Yield the rows of a Parquet file, or some columns of them; a few at a time are in memory."""
    with reading(path), open_table(path, columns) as file:
        for batch in file.iter_batches(
            ROWS_AT_ONCE, columns=None if columns is None else list(columns)
        ):
            if batch.nbytes > ROWS_BYTES:
                raise ReadError(
                    f"{path} cannot be read: {len(batch)} of its rows have {batch.nbytes} bytes"
                )
            yield from batch.to_pylist()


_WIDTHS = {"BOOLEAN": 1, "INT32": 4, "INT64": 8, "INT96": 12, "FLOAT": 4, "DOUBLE": 8}
_DICTIONARIES = {"PLAIN_DICTIONARY", "RLE_DICTIONARY"}
_PLACE = 8
"""Bytes of a value besides its content: its place in a list or in text."""


def _decoded_bytes(file: pq.ParquetFile, path: Path, columns: Collection[str] | None) -> int:
    """Return how large a file grows, from its footer; where that leaves it open, from its
    dictionaries of texts.
    """
    import pyarrow.parquet as pq

    schema = pq.ParquetSchema(
        file.metadata
    )  # `file.schema` would keep the metadata of 10,000 row groups until gc runs
    leaves = [schema.column(number) for number in range(len(schema))]
    fields = [field for field in file.schema_arrow for _ in range(_leaves(field.type))]
    total, texts = file.metadata.num_rows * _PLACE, None
    for group in range(file.metadata.num_row_groups):
        chunks = file.metadata.row_group(group)
        for number, (leaf, field) in enumerate(zip(leaves, fields, strict=True)):
            if columns is not None and field.name not in columns:
                continue
            chunk = chunks.column(number)
            values = _places(field.type, chunks.num_rows, chunk.num_values)
            width = _WIDTHS.get(chunk.physical_type, max(leaf.length, 0) + _PLACE)
            total += max(
                values * (width + _PLACE * bool(leaf.max_repetition_level)),
                chunk.total_uncompressed_size,
            )
            if "DELTA_BYTE_ARRAY" in chunk.encodings:
                raise ValueError(
                    f"its column {field.name} is stored as DELTA_BYTE_ARRAY, whose size nothing "
                    f"tells"
                )
            longest = values * chunk.total_uncompressed_size
            if (
                chunk.physical_type == "BYTE_ARRAY"
                and longest > TABLE_BYTES
                and _DICTIONARIES & {*chunk.encodings}
            ):
                texts = texts or pq.ParquetFile(
                    regular(path), read_dictionary=[leaf.path for leaf in leaves]
                )
                total += sum(
                    map(
                        _text_bytes,
                        texts.read_row_group(group, columns=[leaf.path]).column(0).chunks,
                    )
                )
            if total > TABLE_BYTES:
                return total
    return total


def _leaves(kind: pa.DataType) -> int:
    """Return of how many columns of numbers or texts a column of a type consists."""
    inner = kind.storage_type if hasattr(kind, "storage_type") else kind
    return sum(_leaves(inner.field(number).type) for number in range(inner.num_fields)) or 1


def _places(kind: pa.DataType, rows: int, values: int) -> int:
    """Return how many values a column of a type may have place for: a list of a fixed size takes it
    even if null.
    """
    import pyarrow as pa

    kind = kind.storage_type if hasattr(kind, "storage_type") else kind
    if pa.types.is_fixed_size_list(kind):
        rows *= kind.list_size
    elif pa.types.is_nested(kind) and not pa.types.is_struct(kind):
        rows = values
    return max(
        [rows, values, *(_places(kind.field(i).type, rows, values) for i in range(kind.num_fields))]
    )


def _text_bytes(array: pa.Array) -> int:
    """Return the size of a column of texts that holds each text once and refers to it."""
    import pyarrow as pa

    if not pa.types.is_dictionary(array.type):
        return _text_bytes(array.field(0) if pa.types.is_struct(array.type) else array.flatten())
    lengths = np.array(
        [len(text or b"") for text in array.dictionary.cast(pa.large_binary()).to_pylist()],
        np.int64,
    )
    return int(lengths[array.indices.drop_null().to_numpy(zero_copy_only=False)].sum())
