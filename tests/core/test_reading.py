"""Files that are damaged, of another kind or of other types are refused in one sentence."""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.reading import (
    ReadError,
    decoded,
    inside,
    read_arrays,
    read_json,
    read_rows,
    read_table,
    read_yaml,
    validated,
)  # fmt: skip
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store, open_dataset
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.results import read_results
from tests.dataset.episodes import write
from tests.synthetic import run_info, synthetic_episode, write_results
from tests.verify.test_forgeries import EGO, column


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "results"
    info = run_info("me", extra={"inference": "sync"})
    write_results(folder, [synthetic_episode(seed, image_size=None) for seed in range(2)], info)
    return folder


OPENERS: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "results": (read_results, ["metrics.json", "episodes.parquet", "actions.npz"]),
    "dataset": (
        open_dataset,
        [
            "meta/info.json",
            "meta/tasks.parquet",
            "meta/stats.json",
            "meta/episodes/chunk-000/file-000.parquet",
            "data/chunk-000/file-000.parquet",
        ],
    ),
    "actor": (
        lambda folder: PolicyAgent(str(folder)),
        ["config.json", "model.safetensors", "policy_preprocessor.json"],
    ),
}
"""For each fixture that makes an artifact: what opens it, and its files."""


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize("damage", [cut, pipe])
@pytest.mark.parametrize("artefact", OPENERS)
def test_a_file_that_is_cut_or_no_file_is_one_sentence(
    damage: Callable[[Path], None],
    artefact: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    opener, names = OPENERS[artefact]
    for name in names:
        whole = shutil.copytree(request.getfixturevalue(artefact), tmp_path / "copy")
        damage(whole / name)
        with pytest.raises((ReadError, FileNotFoundError)) as refused:
            opener(whole)
        assert "\n" not in str(refused.value), name
        shutil.rmtree(whole)


def test_an_image_that_names_a_file_in_place_of_its_bytes_is_refused(tmp_path, capsys):
    root = write(tmp_path / "d", range(1), encoding=Encoding("images"))
    path = root / "data/chunk-000/file-000.parquet"
    os.mkfifo(tmp_path / "pipe")
    named = {"bytes": None, "path": str(tmp_path / "pipe")}
    column(path.relative_to(root), EGO, lambda images: [named] * len(images))(root)
    words = ["view", "--dataset", str(root), "--episode", "0", "--out", str(tmp_path / "x.gif")]
    assert main(words) == 2
    assert str(path) in capsys.readouterr().err


VALUES: list[Any] = [None, True, -1, 10**30, float("nan"), "x", [None], {"x": {}}, "\ud800"]


def changes(content: dict[str, Any], depth: int) -> Iterator[dict[str, Any]]:
    """Yield a JSON object with one value in it replaced by another type, at some depth, or
    removed.
    """
    for key, held in content.items():
        yield {name: value for name, value in content.items() if name != key}
        yield from (content | {key: value} for value in VALUES)
        if depth > 1 and isinstance(held, dict) and key not in ("metrics", "per_kind"):
            yield from (content | {key: value} for value in changes(held, depth - 1))


@pytest.mark.parametrize(
    ("artefact", "name", "opener"),
    [
        ("results", "metrics.json", lambda root: read_results(root).conditions),
        ("dataset", "meta/info.json", lambda root: (Store(root).image_keys, Store(root).rows)),
        ("dataset", "meta/manifest.json", Manifest.read),
    ],
)
def test_a_wrong_value_anywhere_is_read_or_refused_but_no_fault(
    artefact, name, opener, request, tmp_path
):
    root = shutil.copytree(request.getfixturevalue(artefact), tmp_path / "copy")
    content = json.loads((root / name).read_text())
    for changed in changes(content, 2):
        (root / name).write_text(json.dumps(changed))
        with suppress(ReadError):
            opener(root)


@pytest.mark.parametrize("text", ['{"x": {"y": 1, "y": 2}}', "NaN", "1e999", "[" * 100_000, "\xff"])
def test_json_holds_finite_numbers_and_each_key_once(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(text, "latin-1")
    with pytest.raises(ReadError, match=r"x\.json cannot be read"):
        read_json(path)


def test_yaml_makes_no_objects_and_holds_each_key_once(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    for text in ("x: 1\nx: 2", "x: !!python/object/apply:os.getpid []", "- x"):
        path.write_text(text)
        with pytest.raises(ReadError, match=r"x\.yaml cannot be read"):
            read_yaml(path)


@dataclass(frozen=True)
class Inner:
    sizes: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Inner = Inner()
    share: float = 0.5

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise ValueError(f"share must be 0 to 1, got {self.share}")


def test_values_become_a_dataclass_or_a_sentence_with_key_and_value() -> None:
    values = {"name": "x", "inner": {"sizes": [3]}, "share": 1}
    assert validated(Outer, values) == Outer("x", Inner((3,)), 1.0)
    for changes, sentence in (
        ({"inner": {"sizes": [1, "two"]}}, "sizes.1 .*integer.*'two'"),
        ({"name": 3}, "name .*string.*3"),
        ({"share": 2}, "share must be 0 to 1, got 2"),
        ({"share": "1"}, "share .*number.*'1'"),
        ({"inner": {"sizes": [True]}}, "sizes.0 .*integer.*True"),
    ):
        with pytest.raises((TypeError, ValueError), match=sentence):
            validated(Outer, values | changes)
    with pytest.raises(TypeError, match="name"):
        validated(Outer, {"share": 1})


def test_unknown_keys_are_refused_where_people_write_and_ignored_elsewhere() -> None:
    values = {"name": "x", "inner": {"sizes": [3], "colour": "red"}}
    assert validated(Outer, values) == Outer("x", Inner((3,)))
    with pytest.raises(ValueError, match="no 'colour'; its fields: sizes"):
        decoded(Outer, values)


def test_tables_that_lack_or_repeat_a_column_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"x": [1]}), path)
    with pytest.raises(ReadError, match="no column 'z'"):
        read_table(path, ["z"])
    pq.write_table(pa.Table.from_arrays([pa.array([1])] * 2, ["x", "x"]), path)
    with pytest.raises(ReadError, match="column x appears again"):
        read_table(path)


def test_tables_of_many_rows_are_read_whole(tmp_path: Path) -> None:
    rows = [{"a.b": [1.0, 2.0 * i], "text": ["x", None]} for i in range(200)]
    path = tmp_path / "x.parquet"
    pq.write_table(pa.Table.from_pylist(rows), path)
    assert list(read_rows(path, read_table(path).schema)) == read_table(path).to_pylist() == rows
    schema = pa.schema({"text": pa.list_(pa.large_string())})
    assert list(read_rows(path, schema)) == [{"text": ["x", None]}] * 200
    with pytest.raises(ReadError, match=r"its column text is of type list<.*it must be double"):
        list(read_rows(path, pa.schema({"text": pa.float64()})))


def test_arrays_that_run_code_or_hold_no_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    np.savez(path, code=np.array([object()], object), text=np.array(["x"]))
    for name, sentence in (("code", "allow_pickle"), ("text", "numbers"), ("none", "none")):
        with pytest.raises(ReadError, match=sentence):
            read_arrays(path, [name])


def test_names_in_files_stay_in_their_folder_or_the_hubs_cache(tmp_path: Path) -> None:
    folder = tmp_path / "models--you--x" / "snapshots" / "c0ffee"
    blob = tmp_path / "models--you--x" / "blobs" / "b10b"
    for path in (folder / "weights", folder / "stolen", blob):
        path.parent.mkdir(parents=True, exist_ok=True)
    blob.touch()
    (folder / "weights").symlink_to("../../blobs/b10b")
    (folder / "stolen").symlink_to("/etc/passwd")
    assert inside(folder, "weights").samefile(blob)
    for name in ("stolen", "../x", "/etc/passwd", "../../blobs/b10b", ".", "a\0", None):
        with pytest.raises(ReadError, match="not inside"):
            inside(folder, name)
