"""Modules that installed distributions name as entry points register by themselves."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.tools import install, python

MOTION = '''
"""A motion of somebody else."""

from dataclasses import dataclass

from dynahoi_lerobot.motions import MOTIONS

assert "lob" in MOTIONS  # a plugin may look names up while it is imported


@MOTIONS.register("{name}")
@dataclass(frozen=True)
class Borrowed(MOTIONS["constant"]):
    """x = a: a straight line under another name."""
'''


def dynahoi(site: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)


def names(listed: subprocess.CompletedProcess[str]) -> list[str]:
    assert listed.returncode == 0, listed.stderr
    return [row["name"] for row in json.loads(listed.stdout)]


def test_a_plugin_is_listed_and_a_broken_one_is_named(tmp_path: Path) -> None:
    sound = {"sound_motion": MOTION.format(name="glide"), "sound_object": "import tests.third_party.things"}
    install(tmp_path, "sound", sound)
    install(tmp_path, "broken", {"broken_motion": "1 / 0", "greedy_motion": MOTION.format(name="lob")})
    motions = dynahoi(tmp_path, "list", "motions", "--json")
    assert "glide" in names(motions)
    assert names(motions).count("lob") == 1
    assert "plugin 'broken_motion' of broken (broken_motion) could not be imported: ZeroDivision" in motions.stderr
    assert "the plugin 'greedy_motion' of broken" in motions.stderr
    assert "the motion name 'lob' is taken" in motions.stderr
    assert "caltrop" in names(dynahoi(tmp_path, "list", "objects", "--json"))


def test_an_edit_in_any_module_of_a_plugins_package_changes_the_code_fingerprint(tmp_path: Path) -> None:
    def fingerprint() -> str:
        script = "from dynahoi_lerobot.sampling.fingerprint import code_fingerprint; print(code_fingerprint())"
        return python("-c", script, PYTHONPATH=str(tmp_path))

    without = fingerprint()
    (tmp_path / "borrowed").mkdir()
    (tmp_path / "borrowed/speeds.py").write_text("FAST = 1.0")
    install(tmp_path, "sound", {"borrowed/__init__": MOTION.format(name="glide")})
    entries = tmp_path / "sound-1.0.dist-info/entry_points.txt"
    entries.write_text("[dynahoi_lerobot.plugins]\nglide = borrowed\n")
    installed = fingerprint()
    (tmp_path / "borrowed/speeds.py").write_text("FAST = 2.0")
    assert len({without, installed, fingerprint()}) == 3
