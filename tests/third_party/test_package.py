"""A package of somebody else, as docs/extend.md describes it, is used once it is installed."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dynahoi_lerobot.core.reading import LeftOut
from dynahoi_lerobot.evaluate.results import read_results
from tests.tools import python

PACKAGE = Path(__file__).parent / "lerobot_policy_forward"
ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("uv"), reason="uv installs the package")
def test_its_task_metric_and_policy_are_used_by_commands(tmp_path: Path) -> None:
    source = shutil.copytree(PACKAGE, tmp_path / "source")
    site = tmp_path / "site"
    words = ["--offline", "--no-deps", "--python", sys.executable, "--target", str(site)]
    subprocess.run(["uv", "pip", "install", "--quiet", *words, str(source)], check=True)
    python("-m", "tests.third_party.use_package", tmp_path, cwd=ROOT, PYTHONPATH=str(site))
    for folder in ("results", "in_lerobot"):
        with pytest.warns(LeftOut, match="E_near"):
            results = read_results(tmp_path / folder)
        assert [row["kind"] for row in results.rows] == ["a_drift"] * 2
        assert results.info.recipe["motions"] == ["a_drift"]
        assert results.head["metrics"]["E_near"]["n"] == 2
