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
from tests.docs.playing import Player, check_installation, link_folders


def recipes(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / "recipes" / folder).iterdir())]


def commands(path: Path) -> tuple[list[list[str]], list[str], list[list[str]]]:
    """Return the commands in the header of a training recipe: those that make the dataset, the
    training, and those that follow.
    """
    lines = re.findall(r"^#   (\S.*)$", path.read_text(), re.MULTILINE)
    found = [shlex.split(line) for line in lines]
    n = [words[0] for words in found].index("lerobot-train")
    return found[:n], found[n], found[n + 1 :]


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
    made, train, _ = commands(path)
    *_, last = made
    assert last[0] == "dynahoi"
    assert config.dataset.root in last
    assert train[:2] == ["lerobot-train", f"--config_path={path.relative_to(ROOT)}"]
    for words in made:
        if words[0] == "uv":
            check_installation(words)


@pytest.mark.nightly
@pytest.mark.slow
def test_recipes_that_no_page_trains_do_so_as_their_headers_say(tmp_path, subtests, monkeypatch):
    monkeypatch.chdir(tmp_path)
    link_folders(tmp_path)
    run = Player().run
    played_by_pages = [words for page in pages() for words in page.commands]
    done = []
    for path in recipes("train"):
        made, train, following = commands(path)
        if train in played_by_pages:
            continue
        with subtests.test(recipe=path.stem):
            for words in made:
                if words not in done:
                    run(words)
                    done.append(words)
            run([*train, "--env_eval_freq=2", "--env.task=lob", "--eval.n_episodes=1"])
            (played,) = (tmp_path / "outputs" / path.stem / "dynahoi").iterdir()
            assert len(read_results(played).rows) == 1
            for words in following:
                run(words)
                assert len(read_results(Path(words[words.index("--out") + 1])).rows) == 2
