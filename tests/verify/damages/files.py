"""Files that are cut, changed, exchanged, linked or not there."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from tests.verify.forgery import (
    DATA,
    INFO,
    MANIFEST,
    OTHER_VIDEO,
    ROWS,
    TASKS,
    VIDEO,
    Damage,
    Table,
    entry,
    file,
    flip,
    folder_instead,
    half,
    swap,
)

HIST = "meta/histograms.json"
STATS = "meta/stats.json"


def link_out(name: str) -> Damage:
    def apply(root: Path) -> None:
        outside = shutil.copy(root / name, root.with_name("outside"))
        (root / name).unlink()
        (root / name).symlink_to(outside)

    return apply


FILES: Table = {
    **{
        f"{kind} of {title}": (file(name, change), "default", name.rsplit("/", 1)[-1])
        for name, title in ((DATA, "frames"), (ROWS, "the episode table"), (TASKS, "the tasks"), (VIDEO, "a video"))
        for kind, change in (("truncation", half), ("emptying", lambda c: b""), ("a flipped last byte", flip(0.99999)))
        if not (name == VIDEO and kind == "a flipped last byte")
    },
    # where the byte falls decides whether the file cannot be read or has other values
    "a flipped byte within the frames": (file(DATA, flip(0.3)), "default", "data"),
    "a flipped byte within the episode table": (file(ROWS, flip(0.25)), "default", "episode"),
    "a flipped byte in a video's index": (
        file(VIDEO, lambda c: flip((c.index(b"stsz") + 21) / len(c))(c)), "default", "file-000.mp4"
    ),
    "a flipped byte in a video's pictures": (file(VIDEO, flip(0.3)), "decode", "pictures: observation.images.ego"),
    **{
        f"{kind} of {name}": (file(name, change), "default", f"{name} cannot be read")
        for name in (INFO, STATS, HIST, MANIFEST)
        for kind, change in (("truncation", half), ("emptying", lambda c: b""), ("a list instead", lambda c: b"[]"))
        if not (name == MANIFEST and kind == "a list instead")
    },
    "binary in info.json": (file(INFO, lambda c: b"\xff\xfe" + c), "default", "info.json cannot be read"),
    "deeply nested JSON": (file(STATS, lambda c: b"[" * 100_000), "default", "stats.json cannot be read"),
    "info.json without features": (entry(INFO, lambda i: i.pop("features")), "default", "no table of features"),
    "a data file gone": (lambda root: (root / DATA).unlink(), "default", "data holds no parquet file"),
    "a video gone": (lambda root: (root / OTHER_VIDEO).unlink(), "default", "file-001.mp4 cannot be read"),
    "the manifest gone": (lambda root: (root / MANIFEST).unlink(), "default", "manifest.json is missing"),
    "a folder instead of a video": (folder_instead(VIDEO), "default", "file-000.mp4"),
    "a folder instead of a table": (folder_instead(DATA), "default", "file-000.parquet cannot be read"),
    "swapped videos": (swap(VIDEO, OTHER_VIDEO), "default", "file-000.mp4 has"),
    "swapped tables": (swap(DATA, ROWS), "default", "file-000.parquet"),
    "a symbolic link": (link_out(VIDEO), "default", "is a symbolic link, to"),
    "a link in a circle": (lambda root: (root / "loop").symlink_to(root), "default", "loop is a symbolic link"),
    "a named pipe": (lambda root: os.mkfifo(root / "meta/pipe"), "default", "meta/pipe is no regular file"),
    "an empty folder": (lambda root: (root / "data/chunk-001").mkdir(), "default", "data/chunk-001 is an empty folder"),
    "a manifest of files elsewhere": (
        entry(MANIFEST, lambda m: m["files"].update({"../x": "0"})), "unsigned", "names '../x', outside"
    ),
    "a stray file": (lambda root: (root / "run.py").write_text("1"), "unsigned", "run.py is not in the manifest"),
    "a changed manifest": (entry(MANIFEST, lambda m: m["yields"].update(missed=1)), "unsigned", "json has changed"),
    "a changed file": (file(STATS, lambda c: c + b" "), "unsigned", "stats.json has changed"),
    "an unknown manifest format": (entry(MANIFEST, lambda m: m.update(format=9)), "default", "unknown format"),
    "text as the manifest's seeds": (entry(MANIFEST, lambda m: m.update(seeds="0")), "default", "a str as 'seeds'"),
}  # fmt: skip
