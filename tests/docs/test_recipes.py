"""Every recipe is what its folder says; those of ``recipes/train`` run as their headers or pages
say.
"""

import re
import shlex
from pathlib import Path

import draccus
import pytest
import yaml
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.import_utils import register_third_party_plugins

from dynahoi_lerobot.evaluate.results import read_results
from dynahoi_lerobot.pretrain.recipe import read_recipe
from dynahoi_lerobot.rollout.recording import load_recording
from tests.docs.documents import ROOT, pages
from tests.docs.playing import Player, check_installation, prepare

RECIPES = ROOT / "recipes"
HEADER = re.compile(r"^#   (\S.*)$", re.MULTILINE)


def recipes(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((RECIPES / folder).iterdir())]


def commands(path: Path) -> list[list[str]]:
    """Return the words of the commands in the header of a recipe; what they install must be
    there.
    """
    found = [shlex.split(line) for line in HEADER.findall(path.read_text())]
    for words in found:
        if words[0] == "uv":
            check_installation(words)
    return [words for words in found if words[0] != "uv"]


def prepared(path: Path) -> tuple[list[list[str]], str, list[list[str]]]:
    """Return the commands that make the dataset, where it then lies, and those that follow."""
    found = commands(path)
    n = [words[0] for words in found].index("lerobot-train")
    *_, last = found[:n]
    root = last[last.index("--root") + 1] if "--root" in last else last[-1]
    return found[:n], root, found[n:]


@pytest.mark.parametrize("path", recipes("generate", "eye"), ids=lambda path: path.stem)
def test_a_recipe_of_training_data_is_read(path: Path):
    is_eye = path.parent.name == "eye"
    recipe = read_recipe(path).episodes if is_eye else load_recording(path).recipe
    assert recipe.split == "train"


@pytest.mark.parametrize("path", recipes("train", "zoo"), ids=lambda path: path.stem)
def test_a_training_recipe_leaves_the_device_to_lerobot_and_can_be_evaluated(path: Path):
    register_third_party_plugins()
    config = draccus.parse(TrainPipelineConfig, config_path=path, args=[])
    values = yaml.safe_load(path.read_text())
    assert "device" not in values["policy"]
    assert (config.policy.push_to_hub, config.env.split, config.env_eval_freq) == (False, "val", 0)
    (size,) = {feature.shape[-1] for feature in config.policy.image_features.values()} or {
        config.env.image_size
    }
    assert config.env.image_size == size
    (generate, *_), root, (train, *_) = prepared(path)
    assert generate[:2] == ["dynahoi", "generate"]
    assert root == config.dataset.root
    assert train[:2] == ["lerobot-train", f"--config_path={path.relative_to(ROOT)}"]


@pytest.mark.nightly
@pytest.mark.slow
def test_recipes_that_no_page_trains_do_so_as_their_headers_say(tmp_path, subtests, monkeypatch):
    monkeypatch.chdir(tmp_path)  # and back
    prepare(tmp_path)
    generated = set()
    played_by_pages = [words for page in pages() for words in page.commands]
    for path in recipes("train"):
        with subtests.test(recipe=path.stem):
            made, root, (train, *evaluate) = prepared(path)
            if train in played_by_pages:
                continue
            if root not in generated:
                for words in made:
                    Player().run(words)
                generated.add(root)
            Player().run([*train, "--env_eval_freq=2", "--env.task=lob", "--eval.n_episodes=1"])
            out = tmp_path / "outputs" / path.stem
            (played,) = (out / "dynahoi").iterdir()
            assert len(read_results(played).rows) == 1
            for words in evaluate:
                Player().run(words)
                assert len(read_results(Path(words[words.index("--out") + 1])).rows) == 2
