"""Images are those that LeRobot reads; what is wrong with the cache of encoded ones costs a
warning.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.video_utils import FrameTimestampError
from lerobot.utils.feature_utils import dataset_to_policy_features
from lerobot_policy_obact import ObActConfig, recordings
from lerobot_policy_obact.attention import MEMORY_FRAMES
from lerobot_policy_obact.configuration_obact import Rig
from lerobot_policy_obact.decisions import Episodes, episode_losses
from lerobot_policy_obact.network import ObActModel
from safetensors.torch import save_file

from dynahoi_lerobot.dataset import read_episodes
from tests.checkpoints import FEATURES
from tests.tools import edit_json

LENGTHS = [3, 4]


@pytest.fixture
def encode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., torch.Tensor]:
    """Encode the images of a dataset, which are zeros; each call counts in ``encode.calls``."""
    monkeypatch.setattr(recordings, "HF_LEROBOT_HOME", tmp_path)
    config = ObActConfig(encoder="conv", encoder_options={"channels": 8}, **FEATURES)
    model, calls = ObActModel(config), []

    def images(meta: object, key: str, lengths: list[int]) -> Iterator[torch.Tensor]:
        for length in lengths:
            calls.append(length)
            yield torch.zeros(length, 3, 32, 32)

    monkeypatch.setattr(recordings, "_images", images)

    def call(**changes: object) -> torch.Tensor:
        for name, value in changes.items():
            setattr(config, name, value)
        return recordings.encoded_images(
            SimpleNamespace(root=tmp_path / "none"), config, model, LENGTHS
        )

    call.calls = calls  # pyright: ignore[reportFunctionMemberAccess]
    return call


def test_every_image_is_the_one_that_lerobot_reads(dataset: Path):
    lerobot = LeRobotDataset("local/ours", root=dataset, video_backend="pyav")
    key, lengths = lerobot.meta.video_keys[0], list(lerobot.meta.episodes["length"])
    found = torch.cat(list(recordings._images(lerobot.meta, key, lengths)))
    assert len(found) == len(lerobot)
    for i in (0, 1, lengths[0], len(lerobot) - 1):
        assert found[i].equal(lerobot[i][key])
    lengths[-1] += 1
    with pytest.raises(FrameTimestampError):
        list(recordings._images(lerobot.meta, key, lengths))


def test_of_a_dataset_that_lerobot_has_merged_only_actions_are_learned(
    dataset: Path, tmp_path: Path, caplog
):
    root = shutil.copytree(dataset, tmp_path / "merged")
    for name in ("manifest.json", "privileged", "privileged_episodes"):  # which LeRobot drops
        place = root / "meta" / name
        place.unlink() if place.is_file() else shutil.rmtree(place)
    # as LeRobot merges: what an episode lacks is null, and whole numbers become floats
    (file,) = (root / "meta/episodes").glob("*/*.parquet")
    table = pq.read_table(file)
    for number, field in enumerate(table.schema):
        if field.name in (recordings.CAPTURE, recordings.WINDOW):
            cells = [None, *table[field.name].to_pylist()[1:]]
            kind = pa.float64() if pa.types.is_integer(field.type) else field.type
            table = table.set_column(number, field.name, pa.array(cells, kind))
    pq.write_table(table, file)
    ours, merged = (LeRobotDatasetMetadata("local/ours", root=place) for place in (dataset, root))
    known, rig = (recordings.describe(meta, ["observation.images.ego"]) for meta in (ours, merged))
    assert known.capture
    assert known.calibration
    assert rig == Rig(fps=known.fps)
    assert "only actions are learned" in caplog.text
    assert recordings.rules_of(merged) == {}
    features = dataset_to_policy_features(merged.features)
    inputs = {key: features[key] for key in ("observation.images.ego", "observation.state")}
    options = {
        "encoder": "conv",
        "encoder_options": {"channels": 8},
        "cache_images": False,
        "rig": rig,
    }
    config = ObActConfig(
        input_features=inputs, output_features={"action": features["action"]}, **options
    )
    found = recordings.Recordings.encoded(merged, config, ObActModel(config))
    assert found.teacher is None
    first, second, *_ = found.episodes.window
    assert first == 0 < second
    assert found.episodes.window.dtype == torch.long


def trainable(meta: LeRobotDatasetMetadata) -> ObActConfig:
    """A config that learns from what the privileged tables of a dataset know."""
    features = dataset_to_policy_features(meta.features)
    keys = ("observation.images.ego", "observation.state")
    return ObActConfig(
        input_features={key: features[key] for key in keys},
        output_features={"action": features["action"]},
        encoder="conv",
        encoder_options={"channels": 8},
        cache_images=False,
        rig=recordings.describe(meta, [keys[0]]),
    )


def test_targets_are_those_of_the_episodes(dataset: Path):
    meta = LeRobotDatasetMetadata("local/ours", root=dataset)
    config = trainable(meta)
    found = recordings.Recordings.encoded(meta, config, ObActModel(config))
    assert found.teacher is not None
    assert found.places is not None
    targets = found.episodes.targets
    assert targets is not None
    for number, episode in enumerate(read_episodes(dataset, images=False)):
        length = len(episode)
        np.testing.assert_array_equal(found.places[number, :length], episode.target_pose[:, :3])
        path = targets.path[number, : targets.length[number]]
        np.testing.assert_array_equal(path, episode.target_path)
        assert targets.free[number] == (episode.first_localized or length)


def test_privileged_tables_of_other_episodes_and_other_schemas_are_refused(
    dataset: Path, tmp_path: Path
):
    root = shutil.copytree(dataset, tmp_path / "d")
    (file,) = (root / recordings.TRUTH).glob("*/*.parquet")
    pq.write_table(pq.read_table(file).slice(20), file)
    meta = LeRobotDatasetMetadata("local/d", root=root)
    config = trainable(meta)
    with pytest.raises(ValueError, match="of other episodes"):
        recordings.Recordings.encoded(meta, config, ObActModel(config))
    edit_json(root / "meta/manifest.json", lambda content: content.update(schema=0))
    with pytest.raises(ValueError, match=r"schema 0.* reads schema 1"):
        recordings.rules_of(meta)


def test_of_recordings_of_minutes_it_learns_ten_seconds_at_a_time_from_anywhere(
    monkeypatch: pytest.MonkeyPatch,
):
    config = ObActConfig(encoder="conv", encoder_options={"channels": 8}, **FEATURES)
    model, count = ObActModel(config), torch.tensor([1000, 150])
    frame = torch.minimum(torch.arange(1000), count[:, None] - 1)[..., None].float()
    episodes = Episodes(
        torch.zeros(2, 1000, 1, 69),
        frame.expand(-1, -1, 18),
        frame.expand(-1, -1, 18),
        count,
        count * 0,
    )
    attended, encode = [], model.encode_history
    monkeypatch.setattr(
        model,
        "encode_history",
        lambda frames, rows: attended.append(frames) or encode(frames, rows),
    )
    for _ in range(20):
        episode_losses(model, episodes, None)
    seen = [frames.state[..., 0] for frames in attended]
    assert max(frames.shape[1] for frames in seen) <= MEMORY_FRAMES
    assert min(float(long[0]) for long, _ in seen) < 300
    assert max(float(long[0]) for long, _ in seen) > 500
    for long, short in seen:
        assert (long.diff() == 1).all()
        assert short.equal(torch.arange(len(short)).clamp_max(149).float())


def cached(folder: Path) -> Path:
    (file,) = (folder / recordings.CACHE).iterdir()
    return file


def test_it_is_read_again_in_full_precision_and_follows_the_umask(encode, tmp_path: Path):
    before = os.umask(0o027)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        first = encode()
    os.umask(before)
    assert first.dtype == torch.float32
    assert cached(tmp_path).stat().st_mode & 0o777 == 0o640
    assert encode().equal(first)
    assert len(encode.calls) == len(LENGTHS)


SPOILT: dict[str, Callable[[Path], object]] = {
    "type": lambda file: save_file({"sightings": torch.zeros(7, 1, 69, dtype=torch.float16)}, file),
    "size": lambda file: save_file({"sightings": torch.zeros(6, 1, 69)}, file),
    "cut": lambda file: file.write_bytes(file.read_bytes()[:100]),
    "pipe": lambda file: (file.unlink(), os.mkfifo(file)),
    "folder": lambda file: (file.unlink(), file.mkdir()),
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_a_file_that_is_of_no_use_costs_one_warning(encode, tmp_path: Path, caplog, spoil: str):
    first = encode()
    SPOILT[spoil](cached(tmp_path))
    assert encode().equal(first)
    assert len(caplog.records) == 1
    assert len(encode.calls) == 2 * len(LENGTHS)


def test_a_file_of_another_user_is_not_believed(encode, monkeypatch: pytest.MonkeyPatch, caplog):
    encode()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    encode()
    assert "another user" in caplog.text


def test_a_home_that_cannot_be_written_costs_one_warning(encode, tmp_path: Path, caplog):
    (tmp_path / recordings.CACHE).write_text("a file where the folder should be")
    encode()
    assert len(caplog.records) == 1


def test_it_can_be_switched_off(encode, tmp_path: Path):
    encode(cache_images=False)
    assert not (tmp_path / recordings.CACHE).exists()
