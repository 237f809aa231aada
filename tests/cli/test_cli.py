"""The commands list, evaluate and view: what they print and leave."""

import base64
import io
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from dynahoi_lerobot.cli.listing import LISTS
from dynahoi_lerobot.cli.sample_page import stratified
from dynahoi_lerobot.cli.view import Clip, write_clip
from dynahoi_lerobot.dataset import frame_column
from dynahoi_lerobot.dataset.paths import INFO_PATH
from dynahoi_lerobot.evaluate.gif import BORDERS
from dynahoi_lerobot.evaluate.results import read_results
from tests.evaluate.test_gif import pages, total_ms
from tests.tools import dynahoi, edit_json


@pytest.mark.parametrize("what", sorted(LISTS))
def test_list_prints_every_entry_with_a_description(what: str) -> None:
    rows = json.loads(dynahoi("list", what, "--json").out)
    assert rows
    assert all(
        str(value) for row in rows for key, value in row.items() if key in ("description", "ranges")
    )
    shown = dynahoi("list", what).out
    assert max(map(len, shown.splitlines())) <= 100
    words = {word.strip(",:") for word in shown.split()}
    for row in rows:
        for value in row.values():
            assert {word.strip(",:") for word in str(value).split()} <= words


def test_a_reader_that_has_had_enough_gets_no_message() -> None:
    command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", "list", "features"]
    listing = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    listing.stdout.close()
    assert listing.stderr.read() == b""
    listing.stderr.close()
    assert listing.wait() == 141


def test_a_wide_terminal_shows_a_list_as_a_table(monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    table = dynahoi("list", "motions").out.splitlines()
    assert len(table) == len(LISTS["motions"]()) + 2
    assert len({len(line) for line in table}) == 1, "columns are aligned"


def test_an_evaluation_goes_on_where_it_stopped_and_its_episodes_are_shown(tmp_path):
    out = tmp_path / "r"
    shown = {}
    words = ["evaluate", "--policy=constant_velocity", "--motions=planar,constant"]
    words += ["--out", out, "--image-size=32", "--episodes"]
    dynahoi(*words, 2, "--gifs=1")
    first = read_results(out).rows
    dynahoi(*words, 3, "--per-kind")
    rows = read_results(out).rows
    assert [row["seed"] for row in rows[:2]] == [row["seed"] for row in first]
    assert sorted(row["seed"] for row in rows) == [0, 1, 2]
    (gif,) = out.glob("*.gif")
    assert len(pages(gif.read_bytes())) > 5, "equal neighbors are stored once"
    stage = next(row["stage"] for row in rows if row["seed"] == 1)
    for view in ("ego", "side"):
        film = tmp_path / f"{view}.gif"
        words = ["view", "--results", out, "--image-size=32", "--view", view, "--out", film]
        assert dynahoi(*words, "--seed=1").out.endswith(f" {stage}\n")
        shown[view] = film.read_bytes()
    assert shown["side"] != shown["ego"]
    results = read_results(out)
    replace(results, actions=tuple(np.concatenate([log] * 9) for log in results.actions)).write()
    dynahoi(*words, "--seed=1")
    assert film.read_bytes() == shown["side"], "a log may be longer than its episode"
    dynahoi(*words, "--seed=7", code=2)
    said = dynahoi(*words, "--seed=1", "--policy=hold", code=2).err
    assert "--policy has no effect with --results" in said


def test_an_episode_of_a_salted_stream_is_shown_to_who_knows_the_salt(tmp_path):
    out = tmp_path / "r"
    salt = "--salt=a secret of sixteen letters"
    dynahoi("evaluate", "--policy=hold", "--episodes=1", "--image-size=32", salt, "--out", out)
    words = ["view", "--results", out, "--image-size=32", "--out", tmp_path / "film.gif"]
    dynahoi(*words, salt)
    assert (tmp_path / "film.gif").exists()
    assert "as --salt says" in dynahoi(*words, code=2).err


@pytest.mark.parametrize("suffix", ["gif", "mp4", "html"])
def test_a_motion_is_played_into_every_format(suffix: str, tmp_path: Path) -> None:
    out = tmp_path / "new" / f"episode.{suffix}"
    dynahoi("view", "--motion=lob", "--image-size=32", "--out", out)
    assert [path.name for path in out.parent.iterdir()] == [out.name]
    if suffix == "mp4":
        assert set(sizes(out)) == {(32, 32)}
        assert len(sizes(out)) > 20
        write_clip(out, Clip(np.zeros((3, 17, 31, 3), np.uint8), "", None))
        assert sizes(out) == [(32, 18)] * 3, "frames of odd size become a video too"
    else:
        assert out.stat().st_size > 2000


def sizes(path: Path) -> list[tuple[int, int]]:
    """Width and height of every frame of a video."""
    with av.open(str(path)) as film:
        return [(frame.width, frame.height) for frame in film.decode(video=0)]


def test_an_episode_of_a_dataset(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "episode.gif"
    words = ["view", "--episode=3", "--out", out, "--dataset"]
    assert "Catch the blue ball." in dynahoi(*words, dataset).out
    assert total_ms(out.read_bytes()) == 23 * 50, (
        "episode i of the made-up dataset has 20 + i frames"
    )
    first, *_, last = pages(out.read_bytes())
    for page, phase in ((first, "observing"), (last, "localized")):
        assert np.abs(np.array(page.getpixel((0, 0))) - BORDERS[phase]).max() < 12
    slower = shutil.copytree(dataset, tmp_path / "slower")
    for fps, code in ((10, 0), ("10", 2), (0, 2)):
        edit_json(slower / INFO_PATH, fps=fps)
        dynahoi(*words, slower, code=code)
    assert total_ms(out.read_bytes()) == 23 * 100


def test_a_sample_shows_what_the_dataset_holds_in_step(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "sample.html"
    dynahoi("view", "--dataset", dataset, "--sample=2", "--out", out)
    page = json.loads(out.read_text().split('id="data">')[1].split("</script>")[0])
    assert [episode["index"] for episode in page["episodes"]] == [0, 5], (
        "spread over the six of the only kind"
    )
    last = page["episodes"][1]
    pose, action = (
        frame_column(dataset, key)[-last["frames"] :] for key in ("target.pose", "action")
    )
    np.testing.assert_allclose(last["target"], pose[:, :3], atol=1e-4)
    np.testing.assert_allclose(last["action"], action[:, :3], atol=1e-4)
    sheet = Image.open(io.BytesIO(base64.b64decode(last["sheet"].split(",")[1])))
    side = sheet.width // page["columns"]
    assert sheet.height // side == -(-last["frames"] // page["columns"])
    assert stratified(["lob", "ramp", "lob", "lob", "ramp"], 2) == [0, 3, 1, 4], (
        "as many of each kind"
    )
    assert stratified(["lob", "ramp", "lob"], 9) == [0, 2, 1]
