"""What commands share: their failure, types of arguments, and the parser that a dataclass of
options describes.
"""

from argparse import SUPPRESS, ArgumentParser, ArgumentTypeError
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, field, fields
from pathlib import Path
from typing import Any, get_type_hints

from dynahoi_lerobot.core.nested import leaves

BAD_INPUT = 2
"""Exit code."""


class CommandError(RuntimeError):
    """Work that cannot be done though nothing is wrong with the arguments; the message is one
    sentence.
    """


def names(text: str) -> tuple[str, ...]:
    """Return the names in a comma-separated list; none if it is empty."""
    return tuple(text.split(",")) if text else ()


def path(text: str) -> Path:
    """Return a path whose leading ``~`` is the home folder, which a shell leaves in
    ``--root=~/data``.

    Raises:
        ArgumentTypeError: if it is empty, or there is no such home.
    """
    if not text:
        raise ArgumentTypeError("must name a file or folder, got an empty string")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ArgumentTypeError(
            f"there is no home folder for {text!r}; write the path out"
        ) from None


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of a whole number from ``low`` to ``high`` and raises ArgumentTypeError for
    anything else.
    """
    return _reader(int, "a whole number", low, high)


def number(low: float, high: float) -> Callable[[str], float]:
    """Return a parser of a finite number from ``low`` to ``high`` and raises ArgumentTypeError for
    anything else.
    """
    return _reader(float, "a number", low, high)


def _reader[N: (int, float)](
    convert: Callable[[str], N], noun: str, low: N, high: N
) -> Callable[[str], N]:
    def read(text: str) -> N:
        with suppress(ValueError):
            value = convert(text)
            if low <= value <= high:
                return value
        raise ArgumentTypeError(f"must be {noun} from {low} to {high}, got {text or 'nothing'}")

    return read


READERS = {int: int, float: float, str: str, Path: path, tuple[str, ...]: names}
"""What reads an argument, by the type of its field, or of the elements of its list."""


def option(
    default: Any,
    text: str,
    read: Callable[[str], Any] | None = None,
    *,
    repr: bool = True,
    **settings: Any,
) -> Any:
    """Return the dataclass field of an option: ``--dry-run`` for a field ``dry_run``.

    Args:
        default: of the field; False for a switch, ``list`` for an option that may be repeated,
            ``MISSING`` for one that is required.
        text: its help.
        read: parses what is given, instead of the entry of ``READERS`` for the type of the field.
        repr: whether the ``repr`` of the dataclass shows it.
        settings: of argparse, such as ``choices``; or ``compared``, see `Rules`.
    """
    metadata = {"help": text, "required": default is MISSING} | settings
    if read:
        metadata["type"] = read
    if default is list:
        return field(default_factory=list, metadata={"action": "append"} | metadata)
    if default is False:
        metadata["action"] = "store_true"
    return field(default=default, repr=repr, metadata=metadata)


def argument(text: str, **settings: Any) -> Any:
    """Return the dataclass field of a positional argument, with its help and other ``settings`` of
    argparse.
    """
    return field(metadata={"help": text} | settings)


def given_of(cls: type, notes: Mapping[type, str] | None = None) -> Any:
    """Return a dataclass field for what is given of another dataclass and of those within it:
    values by name.

    Each of their ``option`` fields is an option here, unless this class has one of the same name.
    ``notes`` add to the help of all options of a class.
    """
    return field(default_factory=dict, metadata={"part": cls, "notes": notes or {}})


def add_options(parser: ArgumentParser, cls: type) -> None:
    """Declare the options and arguments that a dataclass describes.

    Values that are not given are left out, for the defaults of the dataclass.
    """
    hints = get_type_hints(cls)
    for entry in fields(cls):
        if "part" in entry.metadata:
            for inner, note in _options_of(cls, entry):
                _add_option(parser, inner, inner.type, note)
        else:
            _add_option(parser, entry, hints[entry.name])


def _options_of(cls: type, part: Field[Any]) -> Iterator[tuple[Field[Any], str]]:
    """Yield the options that a ``given_of`` field of ``cls`` stands for, each with its note."""
    own = {entry.name for entry in fields(cls)}
    for source, entry in leaves(part.metadata["part"]):
        if "help" in entry.metadata and entry.name not in own:
            yield entry, part.metadata["notes"].get(source, "")


def _add_option(parser: ArgumentParser, entry: Field[Any], hint: Any, note: str = "") -> None:
    settings = dict(entry.metadata)
    settings.pop("compared", None)
    for kind, read in READERS.items():
        if hint in (kind, kind | None, list[kind]):
            settings.setdefault("type", read)
    told = "; ".join(filter(None, (settings["help"], note)))
    if entry.default not in (MISSING, None, False, "", ()) and "default" not in told:
        told += f" (default: {entry.default})"
    settings |= {"help": told.replace("%", "%%"), "default": SUPPRESS}
    positional = "required" not in settings  # which argparse refuses for those
    name = entry.name if positional else "--" + entry.name.replace("_", "-")
    parser.add_argument(name, **settings)


def read_options(cls: type, given: Mapping[str, Any]) -> Any:
    """Return an instance of the dataclass, from what the parser of ``add_options`` was
    ``given``.
    """
    values = {entry.name: given[entry.name] for entry in fields(cls) if entry.name in given}
    for entry in fields(cls):
        if "part" in entry.metadata:
            names = {inner.name for inner, _ in _options_of(cls, entry)}
            values[entry.name] = {key: value for key, value in given.items() if key in names}
    return cls(**values)


def refuse_given(options: Any, names: Iterable[str], remedy: str) -> None:
    """Raise a ValueError, which ends in ``remedy``, for the first of the named options that has not
    its default.
    """
    for name in names:
        if getattr(options, name) != getattr(type(options), name):
            raise ValueError(f"--{name.replace('_', '-')} {remedy}")


def refuse_others(options: Any, heeded: Collection[str], remedy: str) -> None:
    """Raise a ValueError, which ends in ``remedy``, for the first option that has not its default,
    or is given of another dataclass, and is none of those ``heeded``.
    """
    for entry in fields(options):
        value = getattr(options, entry.name)
        if "part" in entry.metadata:
            names = [*value]
        else:
            factory = entry.default_factory
            default = entry.default if factory is MISSING else factory()
            names = [] if value == default else [entry.name]
        for name in names:
            if name not in heeded:
                raise ValueError(f"--{name.replace('_', '-')} {remedy}")
