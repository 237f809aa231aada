"""No text makes a terminal, a drawing or a card do anything."""

import io
from xml.etree import ElementTree

import numpy as np
import pytest

from dynahoi_lerobot.cli.main import exit_code
from dynahoi_lerobot.core.escaping import Terminal, latex, shortened
from dynahoi_lerobot.dataset.card import histogram_svg, markdown_template

HOSTILE = "\x1b[2J\r\u202e</text><script>x</script> | [click](http://x) `code`\n# heading"


def test_a_long_text_loses_its_middle():
    assert shortened("a word\n and  another", 20) == "a word and another"
    assert shortened("a" * 50 + "b" * 50, 21) == "a" * 10 + "…" + "b" * 10


def test_a_terminal_is_told_no_commands(capsys: pytest.CaptureFixture[str]) -> None:
    def run() -> int:
        print(HOSTILE)
        raise ValueError(HOSTILE)

    assert exit_code("dynahoi", run) == 2
    out, err = capsys.readouterr()
    assert (out.count("\n"), err.count("\n")) == (2, 1)
    assert all(line.isprintable() for line in (out + err).split("\n"))


def test_bars_and_tables_look_as_they_did() -> None:
    stream = io.StringIO()
    for text in ("\r 50 %|█████     |", "a\tb\nc\n"):
        Terminal(stream).write(text)
    assert stream.getvalue() == "\r 50 %|█████     |a\tb\nc\n"


def test_cards_and_drawings_hold_text_as_text() -> None:
    card = markdown_template("| {{ name }} | `{{ name }}` |").render(name=HOSTILE)
    assert "\n" not in card
    assert "<script" not in card
    assert card.count("`") == 2
    assert card.replace("\\|", "").count("|") == 3
    assert "[click](" not in card.replace("\\[", "")
    drawing = ElementTree.fromstring(histogram_svg(np.zeros((3, 1)), ["</text><script>x</script>"]))
    assert "script" not in {element.tag.partition("}")[2] for element in drawing.iter()}


def test_latex_typesets_every_sign_as_it_is() -> None:
    assert latex("\\input{x} 5 % & #1 $a_b^c$ ~") == (
        r"\textbackslash{}input\{x\} 5 \% \& \#1 \$a\_b\textasciicircum{}c\$ \textasciitilde{}"
    )
    assert "\n" not in latex(HOSTILE), "a comment ends with its line"
