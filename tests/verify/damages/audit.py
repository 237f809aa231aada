"""What an audit of an earlier version of verify found to pass."""

from __future__ import annotations

import json

from tests.verify.forgery import (
    MANIFEST,
    VIDEO,
    Damage,
    Table,
    at,
    entry,
    entry_of,
    file,
    forge,
    info,
    kept,
    pictures,
    plan,
    row_is,
)

STATE = "observation.state"
POSE = "target.pose"


def recipe(**values) -> Damage:
    return entry(MANIFEST, lambda m: m["provenance"]["recipe"].update(values))


def parameters(**values) -> Damage:
    def change(row, columns):
        row["parameters"] = json.dumps(json.loads(row["parameters"]) | values, sort_keys=True)

    return change


def frozen(row, columns):
    start = row["window_frames"] - 6
    columns[STATE][start : start + 18] = columns[STATE][start]


def repeated(frames: list) -> list:
    """A frame of the approach takes the place of the first, which shows the scene before anything moved."""
    return [frames[12], *frames[1:]]


AUDIT: Table = {
    "data path leads outside": (info(data_path="../../{chunk_index}{file_index}"), "default", "data_path is '../../"),
    "video path leads outside": (info(video_path="/etc/{video_key}"), "default", "video_path is '/etc/"),
    "instruction replaced by a script": (row_is(task="<script>alert(1)</script>"), "default", "task is '<script>"),
    "another motion": (row_is(motion="lob"), "default", "parameters are not those of motion 'lob'"),
    "another category": (row_is(category="pendulum"), "default", "category is 'pendulum'"),
    "another object": (row_is(object="ring", task="Catch the moving ring."), "default", "has the solids"),
    "another object, instruction kept": (row_is(object="ring"), "default", "seed and recipe allow 'Catch"),
    "parameters of a prescribed path": (forge(parameters(speed_m_s=0.3)), "default", "off the path"),
    "parameters of a throw": (forge(parameters(release_s=0.15), 1), "replay", "to parameters"),
    "another agent": (row_is(agent="hold"), "default", "agent is 'hold'"),
    "another capture rule": (row_is(capture="contact"), "default", "capture is 'contact'"),
    "another split": (row_is(split="test"), "default", "split is 'test'"),
    "another stage": (row_is(stage="localized"), "default", "stage is 'localized'; rule 'attach' says 'captured'"),
    "another number of attempts": (row_is(attempts=2), "default", "attempts is 2; seed and recipe allow 1"),
    "palm distance": (entry_of("palm_distance", 3, lambda x: 0.5), "default", "palm_distance is 0.5000"),
    "code of the plan": (plan(code="0" * 16), "default", "fingerprint is"),
    "seed of the plan": (plan(seed=1), "default", "the plan draws 6 seeds from 1 on"),
    "recipe of the plan": (recipe(instructions="neutral"), "default", "fingerprint is"),
    "no seeds in the manifest": (entry(MANIFEST, lambda m: m.update(seeds=[])), "default", "0 seeds for 6 episodes"),
    "episodes removed": (kept(0, 1, 2, 3), "default", "4 of the plan's 6 seeds are there"),
    "target moved by 2 cm": (
        at(POSE, (slice(None), 2), lambda z: z + 0.02), "default", "target.pose is 0.02 m off the path"
    ),
    "thrown target moved by 2 cm": (
        forge(lambda row, columns: columns[POSE].__setitem__((slice(None), 0), columns[POSE][:, 0] + 0.02), 1),
        "default", "palm_distance is",
    ),
    "fingertips moved by 1 cm": (
        at("observation.fingertips", slice(None), lambda x: x + 0.01), "default", "off the kinematics of its state"
    ),
    "a video frame replaced": (pictures(repeated), "replay", "another picture of ego at frame 0"),
    "bytes appended to a video": (file(VIDEO, lambda c: c + b"secret"), "default", "of which the boxes"),
    "a box appended to a video": (file(VIDEO, lambda c: c + b"\0\0\0\x0dfreesecre"), "default", "of which the boxes"),
    "palm moved by 25 cm": (at(STATE, (10, 0), lambda x: x + 0.25), "default", "observation.state jumps by 0.2"),
    "palm moved by 8 cm": (at(STATE, (10, 0), lambda x: x + 0.08), "default", "m at frame 10; 0.06 m is possible"),
    "palm moved by 25 cm throughout": (at(STATE, (slice(None), 0), lambda x: x + 0.25), "default", "off the kinemat"),
    "target moved by 1 m": (at(POSE, (10, 0), lambda x: x + 1), "default", "target.pose jumps by 1.0"),
    "joint moved by 1.5 rad": (at(STATE, (3, 9), 1.5), "default", "jumps by 1.50 rad at frame 3; 1.20 rad"),
    "state frozen for 18 frames": (forge(frozen), "default", "observation.state is frozen from frame"),
}  # fmt: skip
