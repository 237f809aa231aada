"""The same bytes on every processor of a kind: nothing that decides an episode is left to BLAS.

OpenBLAS rounds differently with the instructions of each generation of processors, and can be told which to use.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PLAY = """
from dynahoi_lerobot.doctor import play

print(*play(44).motions, sep="\\n")
"""


def played_with(kernels: str) -> list[str]:
    """Return the digests of the expert's first two episodes of each kind, played with OpenBLAS's ``kernels``."""
    environment = {**os.environ, "OPENBLAS_CORETYPE": kernels}
    done = subprocess.run([sys.executable, "-c", PLAY], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.mark.slow
def test_episodes_do_not_depend_on_the_kernels_of_blas() -> None:
    newer, older = played_with("Haswell"), played_with("Sandybridge")
    assert len(newer) == 44
    assert newer == older
