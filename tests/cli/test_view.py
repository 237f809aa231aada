"""``dynahoi view``: every source and every format, and one sentence for what cannot be shown."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image, ImageSequence

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.cli.sample_page import stratified
from dynahoi_lerobot.cli.view import Clip, write_clip
from dynahoi_lerobot.dataset import frame_column
from dynahoi_lerobot.evaluate.gif import BORDERS

CHECKPOINT = Path(__file__).parents[2] / "checkpoints" / "obact_standard"


def view(*words: object) -> int:
    return cli.main(["view", *map(str, words)])


def duration_ms(path: Path) -> int:
    """Return how long a GIF plays; frames that are equal are stored once."""
    with Image.open(path) as gif:
        return sum(page.info["duration"] for page in ImageSequence.Iterator(gif))


@pytest.mark.parametrize("suffix", ["gif", "mp4", "html"])
def test_a_motion_is_played_into_every_format(suffix: str, tmp_path: Path) -> None:
    out = tmp_path / "new" / f"episode.{suffix}"
    assert view("--motion", "lob", "--image-size", 32, "--out", out) == 0
    if suffix == "mp4":
        with av.open(str(out)) as film:
            frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert len(frames) > 20
        assert frames[0].shape == (32, 32, 3)
    else:
        assert out.stat().st_size > 2000
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_an_episode_of_a_dataset(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "episode.gif"
    assert view("--dataset", dataset, "--episode", 3, "--out", out) == 0
    assert capsys.readouterr().out == f"Catch the blue ball.: {out}\n"
    assert duration_ms(out) == 23 * 50, "episode i of the made-up dataset has 20 + i frames"
    with Image.open(out) as gif:
        assert np.abs(np.array(gif.convert("RGB").getpixel((0, 0))) - BORDERS["observing"]).max() < 12
        gif.seek(gif.n_frames - 1)  # type: ignore[attr-defined] - of every animated format
        assert np.abs(np.array(gif.convert("RGB").getpixel((0, 0))) - BORDERS["localized"]).max() < 12


def test_a_sample_shows_what_the_dataset_holds_in_step(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "sample.html"
    assert view("--dataset", dataset, "--sample", 2, "--out", out) == 0
    page = json.loads(out.read_text().split('id="data">')[1].split("</script>")[0])
    assert [episode["index"] for episode in page["episodes"]] == [0, 5], "spread over the six of the only kind"
    assert page["command"].endswith("--operation.type=delete_episodes --operation.episode_indices")
    last = page["episodes"][1]
    pose, action = (frame_column(dataset, key)[-last["frames"] :] for key in ("target.pose", "action"))
    np.testing.assert_allclose(last["target"], pose[:, :3], atol=1e-4)
    np.testing.assert_allclose(last["action"], action[:, :3], atol=1e-4)
    sheet = Image.open(io.BytesIO(base64.b64decode(last["sheet"].split(",")[1])))
    side = sheet.width // page["columns"]
    assert sheet.height // side == -(-last["frames"] // page["columns"])


def test_a_sample_has_as_many_of_each_kind() -> None:
    assert stratified(["lob", "ramp", "lob", "lob", "ramp"], 2) == [0, 3, 1, 4]
    assert stratified(["lob", "ramp", "lob"], 9) == [0, 2, 1]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--sample", "1", "--out", "x.gif"], "--out must end in .html, got x.gif"),
        (["--sample", "1", "--view", "side", "--out", "x.html"], "has no view 'side'"),
        (["--episode", "6"], "--episode must be 0 to 5, got 6"),
        (["--episode", "-1"], "--episode must be 0 to 5, got -1"),
        (["--view", "side"], "has no view 'side', only observation.images.ego"),
    ],
)
def test_what_a_dataset_does_not_hold(
    words: list[str], sentence: str, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert view("--dataset", dataset, "--out", tmp_path / "x.gif", *words) == cli.BAD_INPUT
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_policy_plays_at_the_size_it_was_trained_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "policy.mp4"
    assert view("--motion", "planar", "--policy", CHECKPOINT, "--out", out) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"{CHECKPOINT}: Catch")
    with av.open(str(out)) as film:
        assert next(film.decode(video=0)).width == 96


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "--results DIR"),
        (["--motion", "lob", "--results", "r"], "--motion MOTION"),
        (["--motion", "lop"], "unknown motion 'lop' (did you mean 'lob'?)"),
        (["--motion", "lob", "--image-size", "0"], "--image-size is 0"),
        (["--results", "nowhere"], "there is no result folder nowhere"),
    ],
)
def test_bad_sources_are_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert view(*words, "--out", tmp_path / "x.gif") == cli.BAD_INPUT
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_frames_of_odd_size_become_a_video(tmp_path: Path) -> None:
    write_clip(tmp_path / "odd.mp4", Clip(np.zeros((3, 17, 31, 3), np.uint8), "", None))
    with av.open(str(tmp_path / "odd.mp4")) as film:
        assert [(frame.width, frame.height) for frame in film.decode(video=0)] == [(32, 18)] * 3
