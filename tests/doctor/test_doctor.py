"""``dynahoi doctor``: every part has facts, and what is wrong with a machine is said and makes the command fail."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import namedtuple
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.doctor import command, parts
from dynahoi_lerobot.doctor.parts import PARTS, Fact

Usage = namedtuple("Usage", "free")


def facts(name: str, folder: Path = Path()) -> dict[str, Fact]:
    return {fact.name: fact for fact in PARTS[name](folder)}


@pytest.mark.parametrize("name", PARTS.names())
def test_this_machine_has_no_problems_and_every_part_says_something(name: str, tmp_path: Path):
    found = facts(name, tmp_path)
    assert found
    assert all(fact.found for fact in found.values())
    assert not [fact for fact in found.values() if fact.problem]


def test_the_command_prints_and_writes_every_fact_and_fails_with_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    good, bad = Fact("cores", "2", "two workers"), Fact("torch", "0.1", "needs 2", problem=True)
    for found, code, last in (([good], 0, "no problems"), ([good, bad], 1, "problems: torch")):
        monkeypatch.setattr(command, "examine", lambda folder, found=found: iter(found))
        assert main(["doctor", "--json", str(tmp_path / "facts.json")]) == code
        said = capsys.readouterr().out.splitlines()
        assert said[-1] == last
        assert [line.split()[0] for line in said[:-1]] == [fact.name for fact in found]
        written = json.loads((tmp_path / "facts.json").read_text())
        assert [Fact(**fact) for fact in written] == found


def test_a_part_that_breaks_is_a_problem_and_the_others_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def broken(folder: Path):
        raise OSError("no such device")

    monkeypatch.setattr(parts, "PARTS", {"gpu": broken, "processor": PARTS["processor"]})
    first, *others = parts.examine(tmp_path)
    assert first == Fact("gpu", "check failed: OSError: no such device", problem=True)
    assert [fact.name for fact in others] == ["cores", "memory"]


def test_a_full_disk_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda place: Usage(10**8))
    (fact,) = facts("disk", tmp_path / "not" / "there").values()
    assert fact == Fact("disk", f"0.1 GB free in {tmp_path}", "0.5 GB are needed", problem=True)


def test_too_little_memory_is_a_problem(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parts.os, "sysconf", lambda name: 10_000)
    assert facts("processor")["memory"] == Fact("memory", "0.1 GB", "a worker needs 0.9 GB", problem=True)


def test_without_the_default_encoder_only_pictures_can_be_written(monkeypatch: pytest.MonkeyPatch):
    import av.codec

    monkeypatch.setattr(av.codec, "codecs_available", {"libx265"})
    fact = facts("codecs")["PyAV"]
    assert fact.problem
    assert fact.found.endswith("writes hevc")
    assert fact.follows == "only `--codec images` works"


def test_versions_out_of_bounds_and_absent_libraries_are_problems(monkeypatch: pytest.MonkeyPatch):
    wanted = {
        "numpy": [Requirement("numpy>=99")],
        "tqdm": [Requirement("tqdm>=4")],
        "nowhere": [Requirement("nowhere")],
    }
    monkeypatch.setattr(parts, "requirements", lambda: wanted)
    found = facts("versions")
    assert found["numpy"].follows == "needs >=99: pip install 'numpy>=99'"
    assert found["nowhere"].found == "none"
    assert {name for name, fact in found.items() if fact.problem} == {"numpy", "nowhere"}
    assert "tqdm" not in found, "what is as it should be is not worth a line"


def test_the_core_alone_is_no_problem(monkeypatch: pytest.MonkeyPatch):
    known = parts.installed_version
    absent = {"lerobot", "torch", *parts.PLUGINS}
    monkeypatch.setattr(parts, "installed_version", lambda name: None if name in absent else known(name))
    found = facts("versions")
    assert found["lerobot"].found == "none"
    assert "pip install" in found["lerobot"].follows
    assert not [name for name, fact in found.items() if fact.problem]


def test_a_plugin_that_cannot_be_imported_is_a_problem(monkeypatch: pytest.MonkeyPatch):
    entry = EntryPoint("spiral", "no_such_package.spiral", parts.GROUP)
    monkeypatch.setattr(parts, "entry_points", lambda group: [entry])
    fact = facts("plugins")["plugin spiral"]
    assert fact.problem
    assert "No module named 'no_such_package'" in fact.follows


def test_a_machine_without_opengl_has_all_other_renderers(monkeypatch: pytest.MonkeyPatch):
    def fails(words: list[str], **options: object) -> subprocess.CompletedProcess:
        assert words[0] == sys.executable
        return subprocess.CompletedProcess(words, 1)

    monkeypatch.setattr(parts.subprocess, "run", fails)
    assert facts("opengl")["OpenGL"] == Fact("OpenGL", "none", "all renderers but `opengl` work")


def test_the_quickstart_takes_as_long_as_where_it_was_timed_and_twice_that_at_half_the_pace():
    for cores, known_s in ((1, parts.KNOWN_PROCESSOR_S), (2, parts.KNOWN_ELAPSED_S), (16, parts.KNOWN_ELAPSED_S)):
        assert parts.quickstart_s(parts.KNOWN_FRAMES_S, cores) == known_s
        assert parts.quickstart_s(parts.KNOWN_FRAMES_S / 2, cores) == 2 * known_s


def test_the_pace_says_how_long_the_quickstart_takes_here(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parts, "frames_per_s", lambda: parts.KNOWN_FRAMES_S)
    for cores, minutes in ((1, 7), (2, 5)):
        monkeypatch.setattr(parts, "cores", lambda cores=cores: cores)
        assert facts("pace")["pace"].follows == f"the quickstart takes about {minutes} min"
