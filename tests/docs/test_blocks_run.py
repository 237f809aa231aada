"""Every block of code in the pages runs as it is written, with fewer episodes and steps, and leaves
what it should.
"""

import json
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from dynahoi_lerobot.cli import quickstart
from dynahoi_lerobot.evaluate.results import read_results
from tests.docs.documents import ROOT, Block, Page, pages
from tests.docs.playing import Player, prepare
from tests.hub.server import TOKEN
from tests.hub.server import serving as serving_hub
from tests.tools import run
from tests.vlm.server import serving as serving_model

DATA_FORMATS = {"json": json.loads, "yaml": yaml.safe_load, "toml": tomllib.loads}
PROGRAMS = ("python", "bash")
DRAWN = ("", "text", "{toctree}")
REPLY = json.dumps(
    {
        "action_sequence": [{"skill": "WAIT", "params": {}, "duration": 10}],
        "predicted_motion": [{"frame_index": i, "hand_params": [0.0] * 18} for i in range(1, 11)],
    }
)
"""What the stand-in for a vision-language model answers."""


PAGES = {str(page.path.relative_to(ROOT)).removeprefix("docs/"): page for page in pages()}


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_every_block_has_a_language_that_is_tested(page: Page):
    for block in page.all_blocks:
        assert block.language in {*PROGRAMS, *DATA_FORMATS, *DRAWN}, block
        assert block.language in PROGRAMS or not block.commands, (
            "commands are in a block of the language bash"
        )
        if block.language in DATA_FORMATS:
            assert DATA_FORMATS[block.language](block.body)


def test_every_page_with_programs_is_played():
    assert {page for page in PAGES if programs(PAGES[page])} == {
        page for group in GROUPS for page in group.split()
    }


@pytest.fixture
def player(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Player]:
    """An empty folder in which commands find the repository's folders, a Hub and a vision-language
    model.
    """
    before = Path.cwd()
    prepare(tmp_path)
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    with serving_hub() as hub, serving_model(lambda exchange: exchange.say(REPLY)) as (url, _):
        home = {
            "HF_ENDPOINT": hub.url,
            "HF_HOME": str(tmp_path / "home"),
            "HF_TOKEN": TOKEN,
            "HF_HUB_DISABLE_XET": "1",
        }
        yield Player({"USER": "me", "NAME": "tiny", "URL": url}, home)
    os.chdir(before)


# -- outcomes --------------------------------------------------------------------------------------


def check_data(folder: Path) -> None:
    """What generate.md, dataset.md and lerobot.md leave."""
    ours = {path.parents[1] for path in folder.glob("data/*/meta/manifest.json")}
    assert len(ours) >= 10
    for root in ours - {folder / "data/slow"}:
        run(["dynahoi", "verify", str(root)])
    assert not (folder / "data/large").exists(), "a dry run"


def check_results(folder: Path) -> None:
    """What the pages about training and evaluation leave."""
    configs = folder.glob("outputs/*/checkpoints/last/pretrained_model/config.json")
    trained = {path.parents[3].name for path in configs}
    assert trained == {"obact", "act", "act_val", "act_state", "act_2", "act_hub"}
    for results in (folder / "results").iterdir():
        assert len(read_results(results).rows) == (1 if results.name == "lerobot" else 2)
    for clip in ("replayed.gif", "held.gif", "planar.mp4", "episode.html"):
        assert (folder / clip).stat().st_size > 1000
    assert "obact_standard" in (folder / "report.html").read_text()


def run_quickstart(folder: Path) -> None:
    """Run the quickstart, whose dataset, checkpoint and results the pages name; another run finds
    everything there.
    """
    out = folder / "outputs/quickstart"
    command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", "quickstart", "--tiny"]
    said = subprocess.check_output(command, stderr=subprocess.STDOUT, text=True)
    assert said.strip().endswith((out / "report.html").as_uri())
    assert "warning" not in said.lower()
    assert subprocess.check_output(command, text=True).count("already done") == 4
    for log in ("lerobot_train.log", "lerobot_eval.log"):
        assert "libtorchcodec" not in (out / log).read_text()
    run(["dynahoi", "verify", str(out / "dataset")])
    kinds = sorted(quickstart.Options(tiny=True).kinds)
    for name in ("obact", *quickstart.BASELINES):
        rows = read_results(out / "results" / name).rows
        assert sorted(row["kind"] for row in rows) == kinds


def check_first_hour(folder: Path) -> None:
    """What README and the pages for beginners leave."""
    for page in (folder / "report.html", folder / "outputs/quickstart/report.html"):
        assert "S_loc" in page.read_text()
    for results in (folder / "results").iterdir():
        assert len(read_results(results).rows) == 2
    for clip in ("lob.gif", "spiral.gif"):
        assert (folder / clip).read_bytes()[:4] == b"GIF8"


GROUPS: dict[str, tuple[Callable[[Path], None] | None, Callable[[Path], None]]] = {
    "generate.md dataset.md lerobot.md": (None, check_data),
    "train.md evaluate.md policies.md contact.md benchmark.md": (None, check_results),
    "README.md install.md environment.md extend.md": (run_quickstart, check_first_hour),
}
"""Pages that are played one after the other in one folder; what is done before, and what is checked
afterwards."""


def programs(page: Page) -> list[Block]:
    """Blocks that are run; a comment before others says what they need."""
    found = [block for block in page.all_blocks if block.file or block.language in PROGRAMS]
    return [block for block in found if not block.need]


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_every_program_and_command_runs(
    group: str, player: Player, tmp_path: Path, subtests: pytest.Subtests
):
    """One after the other in one folder, because a dataset, a training and an evaluation serve
    several pages.
    """
    before, check = GROUPS[group]
    if before:
        before(tmp_path)
    for page in group.split():
        for number, block in enumerate(programs(PAGES[page])):
            with subtests.test(page=page, block=number):
                start = time.monotonic()
                player.play(block)
                print(f"{page} {number}: {time.monotonic() - start:.1f} s")
    check(tmp_path)
