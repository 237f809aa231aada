import argparse
import json
import shlex

import pytest

from dynahoi_lerobot.cli.main import exit_code
from dynahoi_lerobot.core.arguments import add_options, read_options
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.generate import command
from tests.generate import recorder
from tests.generate.recorder import FakeRecording


def run(*words, record=recorder.record) -> int:
    parser = argparse.ArgumentParser()
    add_options(parser, command.Options)
    options = read_options(
        command.Options, vars(parser.parse_args(["--episodes", "4", *map(str, words)]))
    )
    return exit_code(
        "dynahoi generate", lambda: command.run(options, record=record, recording=FakeRecording())
    )


def test_generates_and_summarizes(tmp_path, capsys):
    root = tmp_path / "d"
    summary = tmp_path / "summary.json"
    assert (
        run("--root", root, "--episodes", 3, "--seed", 7, "--image-size", 16, "--json", summary)
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads(summary.read_text())
    assert (told["episodes"], told["yield"]) == (3, 1.0)
    assert Manifest.read(root).seeds == [7, 8, 9]
    assert told["megabytes"] == pytest.approx(
        sum(f.stat().st_size for f in root.rglob("*.*")) / 1e6, abs=0.1
    )


def test_the_next_commands_can_be_pasted(tmp_path, capsys):
    root = tmp_path / "my data"
    assert run("--root", root, "--image-size", 0) == 0
    look, check = capsys.readouterr().err.rpartition("next: ")[2].splitlines()
    assert shlex.split(look)[:4] == ["dynahoi", "view", "--dataset", str(root)]
    assert shlex.split(check) == ["dynahoi", "verify", str(root)]


@pytest.mark.parametrize(("seconds", "files"), [(1e9, 1), (3, 2)])
def test_a_view_has_one_video_file_unless_that_would_be_too_long(
    tmp_path, seconds: float, files: int
):
    assert run("--root", tmp_path / "d", "--image-size", 16, "--video-seconds", seconds) == 0
    assert len(list((tmp_path / "d").rglob("*.mp4"))) == files
    with pytest.raises(SystemExit):
        run("--root", tmp_path / "e", "--video-seconds", 0)
    assert not (tmp_path / "e").exists()


def test_failure_and_interruption(tmp_path, capsys):
    def interrupted(recipe, seeds):
        yield from recorder.record(recipe, seeds[:1])
        raise KeyboardInterrupt

    def full(recipe, seeds):
        raise OSError(28, "No space left on device")

    assert run("--root", tmp_path / "a", record=interrupted) == 130
    assert "interrupted; run the same command to resume" in capsys.readouterr().err
    assert run("--root", tmp_path / "b", record=full) == 1
    assert "No space left" in capsys.readouterr().err
    assert run("--root", tmp_path / "a") == 0
