"""Whatever is wrong is said in one sentence, which names it and what is right; exit code 2, and
nothing is left.
"""

import shlex
from pathlib import Path

import pytest

from tests.tools import dynahoi

GENERATE = "generate --root made --episodes 1 --motions constant"
CASES = [
    ("generate --worker 2 --root made --episodes 1", "--worker 2"),
    ("dance", "'dance'"),
    ("report nowhere", "nowhere holds no results: metrics.json is missing"),
    ("evaluate --policy expertt", "'expertt'"),
    ("evaluate --policy hold --split train --out x", "'train'"),
    ("evaluate --policy hold --gifs 2", "--gifs 2 needs --out"),
    ("evaluate --policy hold --model m", "--model is for --policy vlm"),
    ("evaluate --policy hold --episodes 111", "must be 1 to 110, all of split test_small; got 111"),
    ("evaluate --policy hold --set a=1", "'hold'"),
    ("evaluate --policy hold --device cuda:7", "--device is for a LeRobot policy, not hold"),
    ("evaluate --policy hold --trust", "--trust is for a LeRobot policy, not hold"),
    ("evaluate --policy hold --motions lop", "'lop' (did you mean 'lob'?)"),
    ("evaluate --policy hold --out recipe.yaml", "recipe.yaml is a file"),
    (
        "evaluate --policy hold --sal 'a secret of sixteen letters' --out x",
        "unrecognized arguments: --sal",
    ),
    ("evaluate --policy hold --inference async --inference-ms 50", "'hold'"),
    ("evaluate --policy vlm", "--model NAME"),
    ("evaluate --policy vlm --model m --protocol observe_then_blind", "observe_then_blind"),
    ("view --out x.gif", "--results DIR"),
    ("view --motion lob --thoughts --out x.gif", "--policy CHECKPOINT"),
    ("view --motion lob --image-size 0 --out x.gif", "--image-size is 0"),
    ("view --motion lob --out x.avi", "'.avi'"),
    ("view --motion lob --seed 46", "--seed must be 0 to 44"),
    ("view --dataset DATASET --sample 1 --view side --out x.html", "'side'"),
    ("view --dataset DATASET --episode 6 --out x.gif", "--episode must be 0 to 5, got 6"),
    ("filter DATASET --out x --margin -1", "-1.0"),
    ("filter DATASET --out x --column velocity", "'velocity'"),
    ("filter DATASET --out x --drop=-1", "-1"),
    ("filter DATASET", "--out DIR"),
    ("filter DATASET --out .", ". exists"),
    ("play --record . --image-size 0", ". exists"),
    ("filter DATASET --out x --drop 0 --margin 2", "--margin finds outliers"),
    ("view --dataset DATASET --seed 3 --out x.gif", "--seed has no effect with --dataset"),
    ("view --dataset DATASET --image-size 32 --out x.gif", "--image-size has no effect"),
    ("view --motion lob --episode 3 --out x.gif", "--episode has no effect with --motion"),
    ("evaluate --replay x --episodes 0", "--episodes must be 1 or more, got 0"),
    ("evaluate --replay x --split val", "--split has no effect with --replay"),
    ("evaluate --replay x --capture contact", "--capture has no effect with --replay"),
    ("evaluate --replay x --set a=1", "--set has no effect with --replay"),
    ("quickstart --evaluation-episodes 6", "from 1 to 5, got 6"),
    ("verify .", "is no LeRobot dataset"),
    ("verify DATASET --replay=-1", "got -1"),
    ("verify x --json missing/summary.json", "missing/summary.json"),
    (f"{GENERATE} --dry-run", "--dry-run needs --executor"),
    (f"{GENERATE} --expert pursit", "'pursit' (did you mean 'pursuit'?)"),
    (f"{GENERATE} --environment-state tru", "known: truth, eye"),
    (f"{GENERATE} --json .", "--json"),
    (f"{GENERATE} --episodes {10**30}", f"{10**30}"),
    (f"{GENERATE} --seed {2**40}", f"seed is {2**40}"),
    (f"{GENERATE} --image-size large", "'large'"),
    (
        f"{GENERATE} --image-size 0 --views side",
        "--views needs images: image_size is 0",
    ),
    (f"{GENERATE},lob,lob", "each motion may be named once, got constant, lob, lob"),
    (f"{GENERATE} --shard-episodes 0", "episodes per shard is 0"),
    (f"{GENERATE} --crf 52", "crf is 52"),
    (f"{GENERATE} --codec images --preset fast", "'fast'"),
    (f"{GENERATE} --recipe recipe.yaml", "motions must be a list, got 'lob'"),
    (f"{GENERATE} --actor nowhere", "'nowhere'"),
    (f"{GENERATE} --actor pursuit", "an actor is a checkpoint, got the baseline 'pursuit'"),
]
"""A command, and what it says; a file recipe.yaml is there, and DATASET stands for one of six
episodes."""


@pytest.mark.parametrize("case", CASES, ids=str)
def test_one_sentence_names_what_was_received_and_what_is_allowed(
    case, dataset, tmp_path, monkeypatch
):
    words, sentence = case
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    (tmp_path / "recipe.yaml").write_text("motions: lob\n")
    said = dynahoi(*shlex.split(words.replace("DATASET", str(dataset))), code=2).err
    assert sentence in said
    assert said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.yaml"]


def test_a_tilde_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    dynahoi("view", "--motion", "lob", "--image-size", 16, "--out=~/clips/lob.gif")
    assert [path.name for path in (tmp_path / "home" / "clips").iterdir()] == ["lob.gif"]
    assert not (tmp_path / "~").exists()
