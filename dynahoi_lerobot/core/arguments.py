"""What commands share: their failure, types of arguments, and options derived from a dataclass."""

import inspect
import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, get_type_hints


class CommandError(RuntimeError):
    """Work that cannot be done though nothing is wrong with the arguments; the message is one sentence."""


def names(text: str) -> tuple[str, ...]:
    """Return the names in a comma-separated list; none if it is empty."""
    return tuple(text.split(",")) if text else ()


def path(text: str) -> Path:
    """Return a path whose leading ``~`` is the home folder, which a shell leaves in ``--root=~/data``.

    Raises:
        ArgumentTypeError: if it is empty, or there is no such home.
    """
    if not text:
        raise ArgumentTypeError("must name a file or folder, got an empty string")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ArgumentTypeError(f"there is no home folder for {text!r}; write the path out") from None


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of a whole number from ``low`` to ``high`` and raises ArgumentTypeError for anything else."""
    return _reader(int, "a whole number", low, high)


def number(low: float, high: float) -> Callable[[str], float]:
    """Return a parser of a finite number from ``low`` to ``high`` and raises ArgumentTypeError for anything else."""
    return _reader(float, "a number", low, high)


def _reader[N: (int, float)](convert: Callable[[str], N], noun: str, low: N, high: N) -> Callable[[str], N]:
    def read(text: str) -> N:
        with suppress(ValueError):
            if low <= (value := convert(text)) <= high:
                return value
        raise ArgumentTypeError(f"must be {noun} from {low} to {high}, got {text or 'nothing'}")

    return read


def add_field_arguments(parser: ArgumentParser, cls: type, fields: Iterable[str], **notes: str) -> None:
    """Declare an option for each of some ``fields`` of a dataclass: ``--control-class`` for ``control_class``.

    Type and help come from the dataclass, whose fields are strings, numbers, flags or tuples of strings, and from the
    ``Attributes`` of its docstring; ``notes`` add to the help of a field. Options that are not given are None.
    """
    hints, docs = get_type_hints(cls), field_docs(cls)
    for name in fields:
        option, text = "--" + name.replace("_", "-"), "; ".join(filter(None, (docs[name], notes.get(name))))
        text = text.replace("%", "%%")
        if (hint := hints[name]) is bool:
            parser.add_argument(option, action="store_true", default=None, help=text)
        else:
            plain = (kind for kind in (int, float, str) if hint in (kind, kind | None))
            parser.add_argument(option, type=names if hint == tuple[str, ...] else next(plain), help=text)


def given_fields(args: Namespace, fields: Iterable[str]) -> dict[str, Any]:
    """Return those of the ``fields`` of a dataclass that the command line gives."""
    return {name: value for name in fields if (value := getattr(args, name, None)) is not None}


def field_docs(cls: type) -> dict[str, str]:
    """Return what the ``Attributes`` section of a dataclass's docstring says of each field, on one line."""
    section = (inspect.getdoc(cls) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^    (\w+): (.+(?:\n {8}.+)*)", section, re.MULTILINE)
    return {name: " ".join(text.replace("``", "").split()).removesuffix(".") for name, text in entries}
