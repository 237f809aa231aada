"""Writes into ``docs/trust.md`` what ``dynahoi certify`` says of honest and of forged results."""

from __future__ import annotations

import io
import shutil
import tempfile
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

from dynahoi_lerobot.cli.main import main
from tests.evaluate import forgeries

PAGE = Path(__file__).parents[1] / "trust.md"
BEGIN, END = "<!-- begin: python -m docs.scripts.certify_walk -->\n", "<!-- end -->"
EVALUATE = "evaluate --policy constant_velocity --episodes 4 --out results/baseline"
CERTIFY = "certify results/baseline"
FORGERIES: dict[str, Callable[[Path], None]] = {
    "metrics.json: the mean E_loc halved": forgeries.better_sum,
    "episodes.parquet: E_loc of the first episode halved": forgeries.better_row,
    "actions.npz: the last 20 commands of the second episode moved by 1 cm": forgeries.another_log,
    "metrics.json: the fingerprint of other code": forgeries.another_fingerprint,
}
"""What is done to the honest results, by what the page says of it."""


def with_walk(page: str) -> str:
    """Return the page with today's output between its two marks."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + "```text\n" + walk() + "```\n" + END + rest.split(END, 1)[1]


def walk() -> str:
    """Return commands and output for honest results, then for each forgery of them."""
    with tempfile.TemporaryDirectory() as folder:
        honest = Path(folder) / "honest"
        _output(EVALUATE, honest)
        parts = [f"$ dynahoi {EVALUATE}\n$ dynahoi {CERTIFY}\n{_output(CERTIFY, honest)}"]
        for title, forge in FORGERIES.items():
            forged = Path(folder) / "forged"
            shutil.copytree(honest, forged)
            forge(forged)
            parts.append(f"# {title}\n$ dynahoi {CERTIFY}\n{_output(CERTIFY, forged)}")
            shutil.rmtree(forged)
    return "\n".join(parts)


def _output(command: str, results: Path) -> str:
    """Return what ``command`` prints with ``results`` as its last word."""
    with redirect_stdout(io.StringIO()) as out:
        main([*command.split()[:-1], str(results)])
    return out.getvalue()


if __name__ == "__main__":
    PAGE.write_text(with_walk(PAGE.read_text()))
    print(PAGE)
