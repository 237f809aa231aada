"""Every block of code in the pages runs as it is written, with fewer episodes and steps, and leaves
what it should.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynahoi_lerobot.cli import quickstart
from dynahoi_lerobot.evaluate.results import read_results
from tests.docs.documents import ROOT, Block, Page, pages
from tests.docs.playing import Player, link_folders
from tests.hub.server import TOKEN
from tests.hub.server import serving as serving_hub
from tests.tools import run
from tests.vlm.server import serving as serving_model

PROGRAMS = ("python", "bash")
REPLY = json.dumps(
    {
        "action_sequence": [{"skill": "WAIT", "params": {}, "duration": 10}],
        "predicted_motion": [{"frame_index": i, "hand_params": [0.0] * 18} for i in range(1, 11)],
    }
)
"""What the stand-in for a vision-language model answers."""


PAGES = {str(page.path.relative_to(ROOT)).removeprefix("docs/"): page for page in pages()}


def test_every_page_with_programs_is_played():
    played = [page for group in GROUPS for page in group.split()]
    assert {page for page in PAGES if programs(PAGES[page])} == {*played}
    blocks = [block for page in PAGES.values() for block in page.blocks]
    elsewhere = [block for block in blocks if block.commands and block.language != "bash"]
    assert not elsewhere, "commands are in blocks of the language bash"


@pytest.fixture
def player(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Player]:
    """An empty folder in which commands find the repository's folders, a Hub and a vision-language
    model.
    """
    link_folders(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    with serving_hub() as hub, serving_model(lambda exchange: exchange.say(REPLY)) as (url, _):
        home = {
            "HF_ENDPOINT": hub.url,
            "HF_HOME": str(tmp_path / "home"),
            "HF_TOKEN": TOKEN,
            "HF_HUB_DISABLE_XET": "1",
        }
        yield Player({"USER": "me", "NAME": "tiny", "URL": url}, home)


GROUPS = (
    "generate.md dataset.md lerobot.md",
    "train.md evaluate.md policies.md contact.md benchmark.md",
    "README.md install.md environment.md extend.md",
)
"""Pages that are played one after the other in one folder, because a dataset, a training and an
evaluation serve several of them."""


def programs(page: Page) -> list[Block]:
    """Blocks that are run; a comment before others says what they need."""
    found = [block for block in page.blocks if block.file or block.language in PROGRAMS]
    return [block for block in found if not block.need]


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_every_program_and_command_runs(
    group: str, player: Player, tmp_path: Path, subtests: pytest.Subtests
):
    for page in group.split():
        for number, block in enumerate(programs(PAGES[page])):
            with subtests.test(page=page, block=number):
                start = time.monotonic()
                player.play(block)
                print(f"{page} {number}: {time.monotonic() - start:.1f} s")
    for manifest in tmp_path.glob("data/*/meta/manifest.json"):
        root = manifest.parents[1]
        if root.name != "slow":  # some episodes of a recording
            run(["dynahoi", "verify", str(root)])
    for results in tmp_path.glob("results/*"):
        assert len(read_results(results).rows) == (1 if results.name == "lerobot" else 2)


@pytest.mark.nightly
@pytest.mark.slow
def test_the_quickstart_is_quiet_and_goes_on(tmp_path: Path):
    command = [sys.executable, "-m", "dynahoi_lerobot.cli.main", "quickstart", "--tiny"]
    said = subprocess.check_output(command, stderr=subprocess.STDOUT, text=True, cwd=tmp_path)
    out = tmp_path / "outputs/quickstart"
    assert said.strip().endswith((out / "report.html").as_uri())
    assert "warning" not in said.lower()
    assert subprocess.check_output(command, text=True, cwd=tmp_path).count("already done") == 4
    for log in ("lerobot_train.log", "lerobot_eval.log"):
        assert "libtorchcodec" not in (out / log).read_text()
    run(["dynahoi", "verify", str(out / "dataset")])
    kinds = sorted(quickstart.Options(tiny=True).kinds)
    for name in ("obact", *quickstart.BASELINES):
        rows = read_results(out / "results" / name).rows
        assert sorted(row["kind"] for row in rows) == kinds
