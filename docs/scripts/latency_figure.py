"""Write the report's figure of S_loc and the other metrics against the latency of inference as a picture for the docs.

python -m docs.scripts.latency_figure RESULTS [RESULTS ...]

Each is a result folder of `dynahoi evaluate`, such as `benchmarks/latency.py` leaves behind.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dynahoi_lerobot.report.entries import read_entries
from dynahoi_lerobot.report.figures.base import FIGURES
from dynahoi_lerobot.report.style import figure_style

PICTURE = Path(__file__).parents[1] / "latency.png"


def main() -> None:
    """Draw what the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+")
    entries = read_entries(parser.parse_args().results)
    with figure_style():
        drawing = FIGURES["latency"].draw(entries)
        if drawing is None:
            parser.error("the results are of one latency; a curve needs two")
        drawing.savefig(PICTURE, dpi=110, facecolor="white", bbox_inches="tight")
    print(PICTURE)


if __name__ == "__main__":
    main()
