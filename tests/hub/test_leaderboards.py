"""The benchmark's dataset, and the page that ranks results, looked at by a browser."""

from __future__ import annotations

import functools
import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from dynahoi_lerobot.evaluate.results import write_results
from dynahoi_lerobot.hub import benchmark_repo
from dynahoi_lerobot.hub.leaderboards import SPLITS, directions, eval_yaml, leaderboards
from dynahoi_lerobot.metrics import METRICS
from dynahoi_lerobot.report import leaderboard_data
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.recipe import Recipe
from tests.hub.conftest import Push
from tests.hub.server import Hub
from tests.synthetic import synthetic_episode

PAGE = Path(__file__).parents[2] / "envs" / "leaderboard"
BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), "")


def test_every_leaderboard_is_a_task_of_the_hubs_file():
    content = yaml.safe_load(eval_yaml())
    assert set(content) == {"name", "description", "evaluation_framework", "tasks"}
    ids = [task["id"] for task in content["tasks"]]
    assert len(set(ids)) == len(ids) == 4 * (3 * 4 + 1)
    assert {task["split"] for task in content["tasks"]} == set(SPLITS)
    assert all(board.metric in METRICS and board.split in BENCHMARK.splits for board in leaderboards())


def test_the_benchmarks_dataset_is_pushed_with_a_table_a_split(tmp_path: Path, hub: Hub, push: Push):
    benchmark_repo.write(tmp_path / "benchmark", count=3)
    code, out, err = push(tmp_path / "benchmark", "me/dynahoi-benchmark")
    assert code == 0, err
    assert "benchmark pushed to" in out
    repository = hub.repos["datasets/me/dynahoi-benchmark"]
    assert set(repository.files) == {"README.md", "eval.yaml", *(f"data/{split}.parquet" for split in SPLITS)}
    _, head, body = repository.files["README.md"].decode().split("---\n", 2)
    assert "--leaderboard me/dynahoi-benchmark\n" in body
    assert "--leaderboard me/dynahoi-benchmark\n" not in (tmp_path / "benchmark" / "README.md").read_text()
    (config,) = yaml.safe_load(head)["configs"]
    assert {entry["split"]: entry["path"] for entry in config["data_files"]} == {
        task["split"]: f"data/{task['split']}.parquet" for task in yaml.safe_load(eval_yaml())["tasks"]
    }
    rows = pq.read_table(tmp_path / "benchmark" / "data" / "test.parquet").to_pylist()
    assert [(row["seed"], row["motion"]) for row in rows] == list(enumerate(BENCHMARK.splits["test"].motions[:3]))


def results(folder: Path, policy: str, caught: int) -> Path:
    """Write whole ``ood_speed``, of which the first ``caught`` episodes are caught."""
    hit, miss = (synthetic_episode(0, image_size=None, **options) for options in ({}, {"miss_m": 0.2}))
    episodes = [(hit if seed < caught else miss, seed) for seed in range(220)]
    write_results(
        folder, [replace(episode, meta=replace(episode.meta, seed=seed)) for episode, seed in episodes],
        policy=policy, split="ood_speed", capture="attach", command="dynahoi evaluate", fingerprint="f",
        extra={"recipe": Recipe(split="ood_speed").stored()},
    )  # fmt: skip
    return folder


@contextmanager
def served(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Serve a folder and keep the paths asked for."""
    asked: list[str] = []

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            asked.append(self.path)

    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/index.html", asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class Cells(HTMLParser):
    """Collects the text of every row of a table."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag == "tr":
            self.rows.append([])
        elif tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data


@pytest.mark.skipif(not BROWSER, reason="needs chromium, which .ci/run installs")
def test_the_page_ranks_results_and_asks_no_other_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shutil.copytree(PAGE, tmp_path / "page")
    folders = [results(tmp_path / name, f"<i>{name}", caught) for name, caught in (("a", 50), ("b", 170))]
    words = ["leaderboard_data", *map(str, folders), "--out", str(tmp_path / "page" / "results.json")]
    monkeypatch.setattr(sys, "argv", words)
    leaderboard_data.main()
    browser = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    with served(tmp_path / "page") as (address, asked):
        command = [*browser, "--virtual-time-budget=5000", "--dump-dom", address]
        page = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    cells = Cells()
    cells.feed(page[page.index("<table>") : page.index("</table>")])
    head, *rows = cells.rows
    assert head == ["#", "policy", "S_loc % ↑", "S_gra % ↑", "S_joint % ↑", "R_time ↑", "n", "protocol"]
    assert [row[:2] for row in rows] == [["1", "<i>b"], ["2", "<i>a"]], "names are text, not markup"
    assert [row[2].split()[0] for row in rows] == ["77.3", "22.7"]
    assert set(asked) <= {"/index.html", "/results.json", "/favicon.ico"}
    assert "/results.json" in asked


def test_the_page_names_no_other_server():
    text = (PAGE / "index.html").read_text()
    assert "http://" not in text
    assert "https://" not in text
    assert "connect-src 'self'" in text
    _, head, _ = (PAGE / "README.md").read_text().split("---\n", 2)
    assert yaml.safe_load(head)["sdk"] == "static"


def test_the_committed_page_has_data_of_this_version():
    data = json.loads((PAGE / "results.json").read_text())
    assert (data["benchmark"], data["directions"]) == (BENCHMARK.version, directions())


def test_a_part_of_a_split_is_refused(tmp_path: Path):
    write_results(
        tmp_path, [synthetic_episode(0, image_size=None)], policy="a", split="test", capture="attach", command="",
        fingerprint="f", extra={"recipe": Recipe(split="test").stored()},
    )  # fmt: skip
    with pytest.raises(ValueError, match="is on no leaderboard: 1 of the 1000 episodes of test were played"):
        leaderboard_data.leaderboard_data([tmp_path])
