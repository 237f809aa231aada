"""What text must not do where it goes to: one function a place. Pages and drawings are escaped by
Jinja and `html`.
"""

import base64
from typing import Any, TextIO


def printable(text: str) -> str:
    """Return ``text`` with whatever a terminal would obey, such as escapes and line ends, written
    out.
    """
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


def shortened(text: str, most: int) -> str:
    """Return ``text`` in one line of at most ``most`` characters, without its middle if need be."""
    line = " ".join(text.split())
    half = (most - 1) // 2
    return line if len(line) <= most else f"{line[:half]}…{line[-half:]}"


def markdown(text: str) -> str:
    """Return ``text`` as one that ends no code, cell, line or address, and begins no HTML or link
    in Markdown.
    """
    line = printable(" ".join(text.split()))
    return line.replace("`", "'").replace("<", "&lt;").replace("|", "\\|").replace("[", "\\[")


_LATEX = str.maketrans(
    {mark: f"\\{mark}" for mark in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {mark: f"${mark}$" for mark in "<>|"}
    | {"≥": r"$\geq$", "↑": r"$\uparrow$", "↓": r"$\downarrow$", "–": "--", "…": r"\ldots{}"}
)


def latex(text: str) -> str:
    """Return ``text`` as one that LaTeX typesets as it is, in a cell or a comment."""
    return printable(text).translate(_LATEX)


def data_url(kind: str, content: bytes) -> str:
    """Return content of a media type, such as ``image/gif``, as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


class Terminal:
    """A stream that writes out what a terminal would obey, but for ends of lines, and the start
    with which bars begin.

    Everything else is as the stream has it.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write ``text``."""
        start = text[: text.startswith("\r")]
        lines = (
            "\t".join(map(printable, line.split("\t"))) for line in text[len(start) :].split("\n")
        )
        return self._stream.write(start + "\n".join(lines))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
