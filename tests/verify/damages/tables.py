"""Tables and JSON files with wrong columns, types, numbers and texts."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from tests.verify.forgery import (
    CAMERA_KEY,
    DATA,
    INFO,
    ROWS,
    TASKS,
    Table,
    at,
    cell,
    entry,
    info,
    kept,
    row_is,
    table,
    with_column,
)

STATE = "observation.state"
HIST = "meta/histograms.json"
STATS = "meta/stats.json"


def swapped_tasks(old: pa.Table) -> pa.Table:
    return with_column(old, "task", pa.array(old["task"].to_pylist()[::-1]))


TABLES: Table = {
    "an extra column of frames": (
        table(DATA, lambda t: t.append_column("extra", pa.array(range(len(t))))), "default", "unknown columns extra"
    ),
    "an extra column of episodes": (
        table(ROWS, lambda t: t.append_column("extra", pa.array(range(len(t))))), "default", "unknown columns extra"
    ),
    "a column gone": (table(DATA, lambda t: t.drop_columns(["captured"])), "default", "lacks the columns captured"),
    "float64 timestamps": (
        table(DATA, lambda t: with_column(t, "timestamp", t["timestamp"].cast(pa.float64()))), "default", "as double"
    ),
    "float actions as text": (
        table(ROWS, lambda t: with_column(t, "seed", t["seed"].cast(pa.string()))), "default", "holds seed as string"
    ),
    "columns in another order": (
        table(DATA, lambda t: t.select(t.column_names[::-1])), "default", "columns in another order"
    ),
    "NaN": (at(STATE, (8, 0), np.nan), "default", "observation.state is not finite at frame 8"),
    "infinity": (at("action", (8, 4), np.inf), "default", "action is not finite at frame 8"),
    "a huge number": (at(STATE, (8, 0), 1e30), "default", "m are possible"),
    "a huge seed": (row_is(seed=2**62), "default", "has seed 4611686018427387904; the plan"),
    "a negative seed": (row_is(seed=-1), "default", "has seed -1; the plan"),
    "a negative length": (cell(ROWS, "length", 0, lambda x: -x), "default", "the episode table says -"),
    "a duplicated frame": (table(DATA, lambda t: pa.concat_tables([t[:5], t[4:]])), "default", "frames in a row"),
    "a duplicated episode row": (table(ROWS, lambda t: pa.concat_tables([t, t[5:]])), "default", "same seed"),
    "a duplicated seed": (row_is(seed=3), "default", "have the same seed, 3"),
    "frames in reverse": (
        table(DATA, lambda t: t.take(pa.array(range(len(t))[::-1]))), "default", "frame_index is"
    ),
    "reordered episodes": (kept(1, 0, 2, 3, 4, 5), "default", "the plan has another order"),
    "shifted timestamps": (
        table(DATA, lambda t: with_column(t, "timestamp", pa.array(np.array(t["timestamp"]) + np.float32(0.01)))),
        "default", "at 20 Hz it is",
    ),
    "a wrong task index": (cell(DATA, "task_index", 0, lambda _: 2), "default", "has frames of task 2"),
    "a task index out of range": (cell(DATA, "task_index", 0, lambda _: -7), "default", "has frames of task -7"),
    "swapped instructions": (table(TASKS, swapped_tasks), "default", "its instruction is"),
    "a look-alike letter": (row_is(task="Catch the movіng ball."), "default", "task is 'Catch the mov"),
    "text direction reversed": (row_is(task="Catch \u202ethe ball."), "default", "no line of printable text"),
    "an empty instruction": (row_is(task=""), "default", "no line of printable text"),
    "a zero byte in a name": (row_is(motion="constant\0"), "default", "unknown motion"),
    "a wrong rate": (info(fps=30), "default", "fps is 30; it is 20"),
    "a wrong version": (info(codebase_version="v2.1"), "default", "codebase_version is 'v2.1'"),
    "another robot": (info(robot_type="so100"), "default", "robot_type is 'so100'"),
    "a wrong total": (info(total_frames=1), "default", "info.json says 1 frames"),
    "a wrong split": (info(splits={"train": "0:99"}), "default", "info.json says the split"),
    "a negative chunk size": (info(chunks_size=-1), "default", "chunks_size is -1"),
    "an unknown entry": (info(shell="rm"), "default", "unknown entries shell"),
    "a renamed dimension": (
        entry(INFO, lambda i: i["features"]["action"]["names"].reverse()), "default", "feature action is"
    ),
    "another codec in info.json": (
        entry(INFO, lambda i: i["features"][CAMERA_KEY]["info"].update({"video.codec": "av1"})), "default", "(height"
    ),
    "stale dataset statistics": (
        entry(STATS, lambda s: s["action"]["q99"].__setitem__(4, 9.0)), "default", "stats.json: action/q99 is"
    ),
    "stale episode statistics": (
        cell(ROWS, "stats/action/max", 2, lambda x: [9.0, *x[1:]]), "default", "episode 2: action/max is"
    ),
    "stale picture statistics": (
        cell(ROWS, f"stats/histogram_of:{CAMERA_KEY}", 2, lambda x: [x[0] + 900, *x[1:]]), "default", "episode 2: obs"
    ),
    "stale histogram": (
        entry(HIST, lambda h: h["action"]["palm_x"]["counts"].__setitem__(0, 7)), "default", "histograms.json does not"
    ),
    "a wrong frame index": (cell(DATA, "frame_index", 3, lambda _: 5), "default", "frame_index is 5; it is 3"),
    "a wrong index": (cell(DATA, "index", 3, lambda _: 7), "default", "index is 7; it is 3"),
    "a wrong episode number": (cell(ROWS, "episode_index", 4, lambda _: 6), "default", "row 4 of the episode table"),
    "a wrong span": (cell(ROWS, "dataset_to_index", 1, lambda x: x + 1), "default", "episode 1 spans frames"),
    "a wrong data file": (cell(ROWS, "data/file_index", 1, lambda _: 9), "default", "which does not exist"),
    "a wrong video range": (
        cell(ROWS, f"videos/{CAMERA_KEY}/from_timestamp", 1, lambda x: x + 0.05), "default", "is said to hold episode 1"
    ),
}  # fmt: skip
