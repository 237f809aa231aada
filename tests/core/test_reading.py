"""Hostile files of every kind in every place are refused in one sentence, soon, and before they
take memory.
"""

import gc
import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.configs import NormalizationMode, PolicyFeature
from lerobot_policy_obact import ObActConfig
from safetensors.torch import load_file, save_file

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.core.reading import (
    ReadError,
    fits,
    inside,
    open_table,
    read_arrays,
    read_json,
    read_rows,
    read_table,
    read_yaml,
)  # fmt: skip
from dynahoi_lerobot.dataset import read_episodes
from dynahoi_lerobot.dataset.manifest import Manifest
from dynahoi_lerobot.dataset.store import Store, open_dataset
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.results import read_results
from tests.checkpoints import saved, tiny_diffusion
from tests.dataset.episodes import write
from tests.synthetic import run_info, synthetic_episode, write_results
from tests.tools import edit_json


@pytest.fixture(autouse=True)
def impatience() -> Iterator[None]:
    """Nothing may wait for a writer of a pipe, or read a device to its end."""

    def give_up(*_: object) -> None:
        pytest.fail("it hangs")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "results"
    info = run_info("me", extra={"inference": "sync"})
    write_results(folder, [synthetic_episode(seed, image_size=None) for seed in range(2)], info)
    return folder


def play_nothing(folder: Path) -> None:
    PolicyAgent(str(folder), "cpu")


OPENERS: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "results": (read_results, ["metrics.json", "episodes.parquet", "actions.npz"]),
    "dataset": (
        open_dataset,
        [
            "meta/info.json",
            "meta/tasks.parquet",
            "meta/stats.json",
            "meta/episodes/chunk-000/file-000.parquet",
        ]
        + ["data/chunk-000/file-000.parquet"],
    ),
    "actor": (
        play_nothing,
        [
            "config.json",
            "model.safetensors",
            "policy_preprocessor.json",
            "policy_postprocessor.json",
        ],
    ),
}
"""For each fixture that makes an artefact: what opens it, and its files."""
PLACES = [
    (artefact, opener, name) for artefact, (opener, names) in OPENERS.items() for name in names
]


def replace_by(make: Callable[[Path], object]) -> Callable[[Path], None]:
    def replace(path: Path) -> None:
        path.unlink()
        make(path)

    return replace


HOSTILE: dict[str, Callable[[Path], object]] = {
    "pipe": replace_by(os.mkfifo),
    "device": replace_by(lambda path: path.symlink_to("/dev/zero")),
    "folder": replace_by(Path.mkdir),
    "loop": replace_by(lambda path: path.symlink_to(path)),
    "cut": lambda path: os.truncate(path, path.stat().st_size // 2),
    "vast": lambda path: os.truncate(path, 2**40),
    "deep": lambda path: path.write_text("[" * 100_000 + "]" * 100_000),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_no_place_takes_a_hostile_file(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    for number, (artefact, opener, name) in enumerate(PLACES):
        whole = shutil.copytree(request.getfixturevalue(artefact), tmp_path / str(number))
        HOSTILE[kind](whole / name)
        with pytest.raises((ReadError, FileNotFoundError)) as refused:
            opener(whole)
        assert "\n" not in str(refused.value), name
        shutil.rmtree(whole)


def test_an_image_is_what_its_cell_holds_and_as_large_as_the_dataset_says(
    tmp_path: Path, capsys
) -> None:
    root = write(tmp_path / "d", range(1), encoding=Encoding("images"))
    rows = pq.read_table(path := root / "data/chunk-000/file-000.parquet")
    os.mkfifo(tmp_path / "pipe")
    images = pa.array([{"bytes": None, "path": str(tmp_path / "pipe")}] * len(rows))
    pq.write_table(
        rows.set_column(
            rows.schema.names.index("observation.images.ego"), "observation.images.ego", images
        ),
        path,
    )
    assert (
        main(["view", "--dataset", str(root), "--episode", "0", "--out", str(tmp_path / "x.gif")])
        == 2
    )
    assert str(path) in capsys.readouterr().err
    edit_json(
        root / "meta/info.json",
        lambda info: info["features"]["observation.images.ego"].update(shape=[4096] * 3),
    )
    with pytest.raises(ReadError, match="take more than"):
        list(read_episodes(root))


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


def test_json_is_bounded(tmp_path: Path) -> None:
    surplus = ['{"x": {"y": 1, "y": 2}}', "[" + "[]," * 16 * 10**5 + "1]"]
    for text in (
        *surplus,
        "NaN",
        "1e999",
        "9" * 30,
        "9" * 5000,
        "[" * 70 + "]" * 70,
        '"\\ud800"',
        "{",
        "\xff",
    ):
        (path := tmp_path / "x.json").write_text(text, "latin-1")
        with pytest.raises(ReadError, match=r"x\.json cannot be read"):
            read_json(path)
    (path := tmp_path / "x.yaml").write_text(
        "a: &a [x, x]\n"
        + "".join(
            f"{n}: &{n} [*{p}, *{p}]\n"
            for p, n in zip("abcdefghijklmnopqrstuvwxy", "bcdefghijklmnopqrstuvwxyz", strict=True)
        )
    )
    with pytest.raises(ReadError, match="more than"):
        read_yaml(path)


N = 10**7
BOMBS: dict[str, Callable[[], dict[str, pa.Array]]] = {
    "one list": lambda: {
        "x": pa.ListArray.from_arrays(pa.array([0, N], pa.int32()), pa.array(np.zeros(N, bool)))
    },
    "null lists": lambda: {"x": pa.nulls(2000, pa.list_(pa.float32(), 10**5))},
    "one text": lambda: {
        "x": pa.DictionaryArray.from_arrays(
            pa.array([0] * 5000, pa.int32()), pa.array(["x" * 2**20])
        )
    },
}


@pytest.mark.parametrize(
    ("value", "hint", "fitting"),
    [
        (3, float, True),
        (True, int, False),
        (1.5, int, False),
        (None, int | None, True),
        ({"x": [1]}, dict[str, list[int]], True),
        ({"x": [True]}, dict[str, list[int]], False),
        (["x"], tuple[str, ...], True),
        ([1], tuple[int, int], False),
        ({"type": "STATE", "shape": [18]}, PolicyFeature, True),
        ({"type": "SMELL", "shape": [18]}, PolicyFeature, False),
        ({"type": "STATE"}, PolicyFeature, False),
    ],
)
def test_a_value_has_the_type_that_is_declared(value: object, hint: Any, fitting: bool) -> None:
    assert fits(value, hint) == fitting


@pytest.mark.parametrize("kind", BOMBS)
def test_a_table_that_grows_is_refused_before_it_does(kind: str, tmp_path: Path) -> None:
    pq.write_table(pa.table(BOMBS[kind]()), path := tmp_path / "x.parquet", compression="zstd")
    assert path.stat().st_size < 2**20
    for read in (read_table, lambda path: list(read_rows(path))):
        with pytest.raises(ReadError, match="expands to"):
            read(path)


def test_tables_whose_size_nothing_tells_or_that_lack_a_column_are_refused(tmp_path: Path) -> None:
    table, path = pa.table({"x": ["a" * 100] * 100}), tmp_path / "x.parquet"
    pq.write_table(table, path, use_dictionary=False, column_encoding={"x": "DELTA_BYTE_ARRAY"})
    with pytest.raises(ReadError, match="DELTA_BYTE_ARRAY"):
        read_table(path)
    pq.write_table(pa.table({"x": [b"y" * 2**20] * 64}), path)
    with pytest.raises(ReadError, match="of its rows have"):
        list(read_rows(path))
    with pytest.raises(ReadError, match="no column 'z'"):
        read_table(path, ["z"])
    pq.write_table(pa.Table.from_arrays([pa.array([1])] * 2, ["x", "x"]), path)
    with pytest.raises(ReadError, match="column x appears again"):
        read_table(path)


def test_honest_tables_and_arrays_are_read(tmp_path: Path) -> None:
    rows = [
        {"a.b": [1.0, 2.0], "text": ["x", None], "image": {"bytes": b"y" * 100}}
        for _ in range(1000)
    ]
    pq.write_table(pa.Table.from_pylist(rows), path := tmp_path / "x.parquet")
    assert list(read_rows(path)) == read_table(path).to_pylist() == rows
    assert list(read_rows(path, ["text"])) == [{"text": ["x", None]}] * 1000
    np.savez(path := tmp_path / "x.npz", a=np.arange(6.0).reshape(2, 3).T, b=np.array(3))
    assert read_arrays(path, ["a", "b"])["a"].tolist() == [[0, 3], [1, 4], [2, 5]]


def test_arrays_that_grow_or_run_code_are_refused(tmp_path: Path) -> None:
    np.savez_compressed(
        path := tmp_path / "x.npz", zeros=np.zeros(N), code=np.array([object()], object)
    )
    for name, sentence in (("zeros", "expands to"), ("code", "array"), ("none", "none")):
        with pytest.raises(ReadError, match=sentence):
            read_arrays(path, [name])


def test_names_in_files_stay_in_their_folder_or_the_hubs_cache(tmp_path: Path) -> None:
    repo = tmp_path / "models--you--x"
    folder = repo / "snapshots" / "c0ffee"
    for place in (folder, repo / "blobs"):
        place.mkdir(parents=True)
    (repo / "blobs" / "b10b").touch()
    (folder / "weights").symlink_to("../../blobs/b10b")
    (folder / "stolen").symlink_to("/etc/passwd")
    (tmp_path / "link").symlink_to(folder)
    for root in (folder, tmp_path / "link"):
        assert inside(root, "weights").samefile(repo / "blobs" / "b10b")
        for name in ("stolen", "../x", "/etc/passwd", "../../blobs/b10b", "", ".", "a\0", None, 3):
            with pytest.raises(ReadError, match="not inside"):
                inside(root, name)


def test_other_weights_and_sizes_are_refused(actor: Path, tmp_path: Path) -> None:
    weights = load_file(actor / "model.safetensors")
    name = next(name for name, tensor in weights.items() if tensor.dim() == 2)
    folder = shutil.copytree(actor, tmp_path / "mistyped")
    save_file(weights | {name: weights[name].to(torch.int8)}, folder / "model.safetensors")
    with pytest.raises(ReadError, match="mistyped"):
        play_nothing(folder)
    for number, change in enumerate(
        ({"dim": 65536, "n_heads": 2}, {"width": 65536}, {"n_layers": 10**9})
    ):
        folder = shutil.copytree(actor, tmp_path / str(number))
        edit_json(folder / "config.json", lambda config, change=change: config.update(change))
        with pytest.raises(ReadError):
            play_nothing(folder)
    folder = tiny_diffusion(tmp_path / "diffusion")
    for key, number in (
        ("num_train_timesteps", 10**7),
        ("horizon", 10**6),
        ("crop_ratio", 10.0**8),
    ):
        whole = (folder / "config.json").read_text()
        edit_json(
            folder / "config.json",
            lambda config, key=key, number=number: config.update({key: number}),
        )
        with pytest.raises(ReadError, match=key):
            play_nothing(folder)
        (folder / "config.json").write_text(whole)


def test_statistics_that_do_not_fit_are_refused(actor: Path, tmp_path: Path) -> None:
    config = ObActConfig.from_pretrained(actor)
    config.normalization_mapping["STATE"] = NormalizationMode.MEAN_STD
    with pytest.raises(ReadError, match=r"observation\.state"):
        play_nothing(saved(config, tmp_path / "none"))
    ones = {"std": torch.ones(18)}
    play_nothing(
        saved(config, tmp_path / "fitting", {"observation.state": ones | {"mean": torch.zeros(18)}})
    )
    for shape in ((18, 18), (17,)):
        folder = saved(
            config,
            tmp_path / str(shape),
            {"observation.state": ones | {"mean": torch.zeros(shape)}},
        )
        with pytest.raises(
            ReadError, match=r"policy_preprocessor\.json normalises observation\.state"
        ):
            play_nothing(folder)


def test_a_table_that_was_closed_stays_in_no_cycle_of_references(tmp_path: Path) -> None:
    pq.write_table(pa.table({"index": [1, 2, 3]}), tmp_path / "t.parquet", row_group_size=1)
    gc.collect()
    gc.disable()  # a footer of 10,000 row groups takes 100 MB, and the collector hardly ever runs
    try:
        open_table(tmp_path / "t.parquet").close()
        assert not [found for found in gc.get_objects() if type(found) is pq.FileMetaData]
    finally:
        gc.enable()
