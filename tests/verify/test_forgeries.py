"""Forgeries that are signed anew are found without a replay: of what LeRobot reads, and of what
follows from seeds and states.
"""

import dataclasses
import shutil
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.verify.command import verify
from tests.dataset.episodes import changed, rewrite, sign
from tests.tools import edit_json, generated

DATA = "data/chunk-000/file-000.parquet"
ROWS = "meta/episodes/chunk-000/file-000.parquet"
TASKS = "meta/tasks.parquet"
TRUTH = "meta/privileged/chunk-000/file-000.parquet"
CONSTANTS = "meta/privileged_episodes/chunk-000/file-000.parquet"
INFO = "meta/info.json"
STATS = "meta/stats.json"
MANIFEST = "meta/manifest.json"
EGO = "observation.images.ego"
SIDE = "observation.images.side"
FLAT = "observation.images.ego_segmentation"
VIDEO = f"videos/{EGO}/chunk-000/file-000.mp4"

Forgery = Callable[[Path], object]


@pytest.fixture(scope="module")
def genuine(tmp_path_factory) -> Path:
    words = "--motions constant,lob --views side,ego_segmentation --video-seconds 5 --image-size 32"
    return generated(tmp_path_factory.mktemp("genuine") / "d", *words.split(), episodes=4)


def told(path: str, *keys: str | int, value: object) -> Forgery:
    """Forge a value of a JSON file: what ``keys`` lead to becomes ``value``, or what it makes of
    it.
    """

    def change(content) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value(content[keys[-1]]) if callable(value) else value

    return lambda root: edit_json(root / path, change)


def table(path: str, change: Callable[[pa.Table], pa.Table]) -> Forgery:
    return lambda root: pq.write_table(change(pq.read_table(root / path)), root / path)


def column(path: str, key: str, change: Callable[[list], list]) -> Forgery:
    def apply(found: pa.Table) -> pa.Table:
        place = found.schema.get_field_index(key)
        field = found.schema.field(key)
        return found.set_column(place, field, pa.array(change(found[key].to_pylist()), field.type))

    return table(path, apply)


def swapped(values: list) -> list:
    return [values[1], values[0], *values[2:]]


def scaled(values: list) -> list:
    return [(np.array(value) * 1.5 + 0.01).tolist() for value in values]


def other_instructions(root: Path) -> None:
    """Exchange two instructions wherever they stand."""
    one, other = pq.read_table(root / TASKS)["task"].to_pylist()[:2]
    exchange = {one: other, other: one}
    column(TASKS, "task", lambda texts: [exchange.get(text, text) for text in texts])(root)
    column(ROWS, "task", lambda texts: [exchange.get(text, text) for text in texts])(root)
    column(
        ROWS, "tasks", lambda rows: [[exchange.get(text, text) for text in texts] for texts in rows]
    )(root)


def templates(root: Path) -> None:
    """Let LeRobot read videos, of another view, from another folder."""
    shutil.copytree(root / f"videos/{SIDE}", root / f"clips/{EGO}")
    shutil.copytree(root / f"videos/{EGO}", root / f"clips/{SIDE}")
    told(INFO, "video_path", value=lambda path: path.replace("videos/", "clips/"))(root)


def other_seeds(root: Path) -> None:
    column(ROWS, "seed", swapped)(root)
    told(MANIFEST, "seeds", value=swapped)(root)


def repeated_under_another_seed(root: Path) -> None:
    first, second, third, fourth = read_episodes(root)
    rewrite(root, [first, second, dataclasses.replace(first, meta=third.meta), fourth])


def further_rows(root: Path) -> None:
    """Append an episode that only the tables hold."""
    table(DATA, lambda found: pa.concat_tables([found, found.slice(0, 20)]))(root)
    told(INFO, "total_frames", value=lambda frames: frames + 20)(root)


def exchanged_videos(root: Path) -> None:
    ego = root / VIDEO
    side = root / VIDEO.replace(EGO, SIDE)
    ego.rename(root / "ego.mp4")
    side.rename(ego)
    (root / "ego.mp4").rename(side)


def rewritten(change: Callable[[Episode], Episode]) -> Forgery:
    """Change the first episode, and all that follows from it."""

    def apply(root: Path) -> None:
        first, *others = read_episodes(root)
        rewrite(root, [change(first), *others])

    return apply


def container(
    change: Callable[[list], list] = list,
    *,
    rate: int = 1,
    further: bool = False,
    matrix: Sequence[int] = (),
) -> Forgery:
    """Put what ``change`` makes of a video's packets into another file: at another pace, beside a
    stream, or turned.
    """

    def apply(root: Path) -> None:
        path = root / VIDEO
        made = root / "again.mp4"
        with av.open(str(path)) as source, av.open(str(made), "w") as target:
            streams = [
                target.add_stream_from_template(source.streams.video[0]) for _ in range(1 + further)
            ]
            packets = [packet for packet in source.demux(video=0) if packet.size]
            places = [packet.pts * rate for packet in packets]
            for packet, place in zip(change(packets), places, strict=False):
                for stream in streams:
                    copy = av.Packet(bytes(packet))
                    copy.stream = stream
                    copy.time_base = packet.time_base
                    copy.is_keyframe = packet.is_keyframe
                    copy.pts = place
                    copy.dts = place
                    copy.duration = rate * (packet.duration or 0)
                    target.mux(copy)
        content = made.read_bytes()
        if matrix:
            place = content.index(b"tkhd") + 44
            content = content[:place] + struct.pack(">9i", *matrix) + content[place + 36 :]
        path.write_bytes(content)
        made.unlink()

    return apply


FORGERIES: dict[str, Forgery] = {
    # instructions
    "instructions exchanged": column(TASKS, "task", swapped),
    "instructions exchanged everywhere": other_instructions,
    "instructions of frames exchanged": column(
        DATA, "task_index", lambda numbers: [1 - min(n, 1) for n in numbers]
    ),
    # places of episodes
    "another video": column(ROWS, f"videos/{EGO}/file_index", lambda files: files[::-1]),
    "times in the video": column(
        ROWS, f"videos/{EGO}/from_timestamp", lambda times: [t + 0.05 for t in times]
    ),
    "times of frames": column(DATA, "timestamp", lambda times: [t + 0.05 for t in times]),
    "lengths": column(
        ROWS, "length", lambda lengths: [lengths[0] - 1, lengths[1] + 1, *lengths[2:]]
    ),
    "rows exchanged": table(ROWS, lambda found: found.take([1, 0, 2, 3])),
    "templates": templates,
    "rows that no episode has": further_rows,
    # info.json
    "number of episodes": told(INFO, "total_episodes", value=3),
    "splits": told(INFO, "splits", value={"train": "0:2", "test": "2:4"}),
    "names of a feature": told(INFO, "features", "action", "names", value=swapped),
    "a feature less": lambda root: edit_json(
        root / INFO, lambda info: info["features"].pop("next.success")
    ),
    # statistics
    "a mean": told(STATS, "action", "mean", value=lambda mean: [mean[0] + 0.1, *mean[1:]]),
    "a count": told(STATS, "action", "count", value=[7]),
    "a mean of images": told(STATS, EGO, "mean", value=[[[0.1]], [[0.2]], [[0.3]]]),
    "a mean of stored pixels": told(STATS, FLAT, "mean", value=scaled),
    "statistics of a column": lambda root: edit_json(
        root / STATS, lambda stats: stats.pop("action")
    ),
    # videos
    "videos of two views exchanged": exchanged_videos,
    "a video at another rate": container(rate=2),
    "an image fewer": container(lambda packets: packets[:-1]),
    "an episode that begins without a key frame": container(swapped),
    "a second stream": container(further=True),
    "a video turned by 90 degrees": container(matrix=(0, 65536, 0, -65536, 0, 0, 0, 0, 2**30)),
    # the manifest
    "seeds in the manifest": told(MANIFEST, "seeds", value=swapped),
    "counts in the manifest": told(MANIFEST, "frames", value=lambda frames: frames + 1),
    "failures": told(MANIFEST, "yields", "failed", value=3),
    "benchmark": told(MANIFEST, "benchmark", value="v0"),
    "first seed of the plan": told(MANIFEST, "provenance", "seed", value=10),
    "recipe": told(
        MANIFEST, "provenance", "recording", "recipe", "rules", "control_class", value="unlimited"
    ),
    # what follows from seeds and states
    "seeds": other_seeds,
    "kinds of motion": column(ROWS, "motion", swapped),
    "masses": column(CONSTANTS, "object_mass", swapped),
    "an episode less in the privileged tables": table(TRUTH, lambda found: found.slice(20)),
    "privileged rows exchanged": table(CONSTANTS, lambda found: found.take([1, 0, 2, 3])),
    "paths": column(CONSTANTS, "target_path", lambda paths: [scaled([paths[0]])[0], *paths[1:]]),
    "phases": rewritten(changed("phase", 3, 0.5)),
    "outcome": column(ROWS, "success", lambda found: [False, *found[1:]]),
    "an episode twice, under another seed": repeated_under_another_seed,
}


@pytest.mark.parametrize("name", FORGERIES)
def test_forgeries_are_found_though_they_are_signed(genuine, tmp_path, name):
    root = shutil.copytree(genuine, tmp_path / "forged")
    FORGERIES[name](root)
    sign(root)
    found = verify(root)
    assert found
    assert not [finding for finding in found if "edited" in finding.message]


def test_what_was_forged_is_genuine_before(genuine):
    assert verify(genuine) == []
