"""Episodes with values that their others contradict; statistics and hashes agree."""

from __future__ import annotations

import numpy as np

from tests.verify.forgery import Table, at, entry_of, forge, row_is

POSE = "target.pose"


def slow(row, columns):
    columns["target.velocity"][:, :3] *= 3


EPISODES: Table = {
    "a failed episode": (row_is(success=False), "default", "success is False"),
    "another protocol": (row_is(protocol="direct_act"), "default", "protocol is 'direct_act'"),
    "another version of the benchmark": (row_is(benchmark="v0"), "default", "benchmark is 'v0'"),
    "another fingerprint": (row_is(fingerprint="f" * 16), "default", "fingerprint is 'ffff"),
    "too many attempts": (row_is(attempts=9), "default", "attempts is 9; seed and recipe allow"),
    "a wrong window": (row_is(window_frames=3), "default", "window_frames is 3"),
    "a wrong length": (row_is(length_frames=3), "default", "length_frames is 3"),
    "a wrong intercept": (row_is(intercept_frame=20), "default", "intercept_frame is 20"),
    "intercept off the path": (
        at("intercept.position", slice(None), lambda x: x + 0.01), "default", "intercept.position is 0.01 m off"
    ),
    "intercept of a throw": (
        forge(lambda row, columns: columns["intercept.position"].__iadd__(np.float32(0.01)), 1),
        "replay", "another intercept.position",
    ),
    "acting in the window": (at("observation.phase", 2, 1.0), "default", "observation.phase is not a window"),
    "localised from the start": (at("localized", slice(None), True), "default", "palm_distance says False"),
    "captured from the start": (at("captured", slice(None), True), "default", "rule 'attach' says False"),
    "a contact that is none": (at("target.contacts", (0, 1), 1.0), "default", "target.contacts is [0.0, 1.0"),
    "half a contact": (at("target.contacts", (0, 1), 0.5), "default", "target.contacts is neither 0 nor 1"),
    "no unit quaternion": (at(POSE, (4, 3), 2.0), "default", "the quaternion of target.pose has norm"),
    "velocity three times as fast": (forge(slow, 2), "default", "target.p"),
    "target turned": (
        at(POSE, (slice(None), slice(3, 7)), np.array([1, 0, 0, 0], np.float32)), "replay", "another target.pose"
    ),
    "an action moved by 2 cm": (at("action", (12, 1), lambda y: y + 0.02), "default", "from where action led"),
    "the last action moved by 2 cm": (at("action", (-1, 1), lambda y: y + 0.02), "replay", "another action"),
    "an action beyond the joints": (at("action", (12, 9), 1.9), "default", "commands are clipped to"),
    "fingertip distance": (entry_of("fingertip_distance", 3, lambda x: 9.0), "default", "fingertip_distance is"),
    "fingertip distance by 1 cm": (
        entry_of("fingertip_distance", 0, lambda x: x - 0.01), "default", "object and poses give"
    ),
    "a shorter palm distance column": (
        forge(lambda row, columns: row["stats/palm_distance"].pop()), "default", "palm_distance has"
    ),
    "another open hand": (entry_of("open_joints", 2, lambda x: 0.1), "default", "not the open hand 'capsule'"),
    "another reference grasp": (entry_of("reference_joints", 2, lambda x: 0.1), "replay", "stats/reference_joints"),
}  # fmt: skip
