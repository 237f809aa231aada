"""``--env.type=dynahoi``: found by LeRobot, played by its evaluation loop, measured in the result
folder.
"""

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from lerobot.configs import parser
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import (
    _call_make_env,
    _import_hub_module,
    _normalize_hub_result,
    env_to_policy_features,
    preprocess_observation,
)
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_env_dynahoi import command_line
from lerobot_env_dynahoi.command_line import Launch, read_launch
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

from dynahoi_lerobot.core.agent import Agent
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent
from dynahoi_lerobot.evaluate.results import Results, read_results
from dynahoi_lerobot.evaluate.rows import episode_row
from dynahoi_lerobot.motions import CATEGORIES
from dynahoi_lerobot.rollout.inference import Inference, RealTimeAgent
from dynahoi_lerobot.sampling.benchmark import BENCHMARK
from dynahoi_lerobot.sampling.salt import stream_label
from dynahoi_lerobot.sampling.sampler import sample_specs
from tests.checkpoints import FEATURES, SHIPPED, tiny_act
from tests.tools import edit_json, options, run
from tests.world.playing import played

SMALL = {"image_size": 32, "split": "test_small"}
SALT = "nobody-shall-know-it"


def test_one_suite_per_category_one_task_per_kind() -> None:
    register_third_party_plugins()
    suites = EnvConfig.get_choice_class("dynahoi")(**SMALL).create_envs(1)
    assert set(suites) == set(CATEGORIES)
    tasks = [env.task for suite in suites.values() for env in suite.values()]
    assert sorted(tasks) == list(BENCHMARK.splits["test"].motions)
    assert all(sorted(suite) == list(range(len(suite))) for suite in suites.values())


def test_lerobots_loop_fills_the_result_folder(act: Path, tmp_path: Path) -> None:
    words = ("--env.split=test_small", "--eval.n_episodes=5", f"--env.salt={SALT}")
    results = through_lerobot(act, tmp_path, *words)
    assert [row["kind"] for row in results.rows] == ["constant"] * 5, (
        "the sixth is the first again, and counts once"
    )
    assert len({row["seed"] for row in results.rows}) == 5
    assert results.summary["E_loc"].value > 0.3
    assert results.info.split == stream_label("test_small", SALT)
    assert not [path for path in tmp_path.glob("*.*") if SALT.encode() in path.read_bytes()], (
        "it stays hidden"
    )


def test_lerobots_loop_and_ours_give_the_same_rows(tmp_path: Path):
    """Of a policy that samples, in worlds of its own here and together there."""
    words = ("--env.task=constant,lob", "--env.split=val", "--env.image_size=96")
    found = through_lerobot(SHIPPED, tmp_path, *words, "--eval.batch_size=1", "--eval.n_episodes=1")
    assert len(found.rows) == 2
    ours = played_here(found, PolicyAgent(str(SHIPPED), "cpu"))
    for row, actions, episode in zip(found.rows, found.actions, ours, strict=True):
        np.testing.assert_array_equal(actions, np.float32(episode.action))
        wanted = episode_row(episode) | {"agent": row["agent"]}
        np.testing.assert_equal(row, {name: wanted[name] for name in row})
    tasks = json.loads((tmp_path / "lerobot" / "eval_info.json").read_text())["per_task"]
    assert [s for task in tasks for s in task["metrics"]["successes"]] == [
        row["success"] for row in found.rows
    ]


def test_features_are_the_datasets_and_further_views_reach_the_policy(tmp_path: Path) -> None:
    config = DynahoiEnvConfig(
        **SMALL, views=("side", "ego_depth"), task="planar", results_dir=str(tmp_path)
    )
    wanted = {f"observation.images.{view}": (3, 32, 32) for view in ("ego", "side", "ego_depth")}
    others = {"observation.state": (18,), "observation.phase": (2,), "action": (18,)}
    features = env_to_policy_features(config)
    assert {key: tuple(feature.shape) for key, feature in features.items()} == wanted | others
    env = config.create_envs(1)["pendulum"][0]
    observation, _ = env.reset(seed=[0])
    assert {key for key in preprocess_observation(observation) if "images" in key} == wanted.keys()
    assert env.observation_space.contains(observation)
    assert "Catch" in env.call("task_description")[0], "LeRobot's loop asks for it"


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> Callable:
    def answer(words: list[str]) -> Launch:
        monkeypatch.setattr(sys, "argv", words)
        return read_launch()

    return answer


def test_results_are_named_after_the_policy_and_say_which_weights_lerobot_eval_played(
    tmp_path: Path, said
) -> None:
    (tmp_path / "config.json").write_text('{"type": "act"}')
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    weights = {"model.safetensors": hashlib.sha256(b"weights").hexdigest()}
    for words, name, sums in (
        (["/bin/lerobot-eval", f"--policy.path={tmp_path}"], "act", weights),
        (["scripts/lerobot_eval.py", "--policy.pretrained_path", str(tmp_path)], "act", weights),
        (["lerobot-train", f"--policy.path={tmp_path}"], "act", {}),  # what training began with
        (["lerobot-train", "--policy.type=obact"], "obact", {}),
        (["somebody's script"], "policy", {}),
        (["lerobot-eval", "--policy.path", "me/policy"], "me/policy", {}),
    ):
        launch = said(words)
        assert (launch.policy, launch.weights) == (name, sums)


def test_the_rules_are_those_of_the_revision_that_lerobot_plays(said, tmp_path, monkeypatch):
    revisions = {"v1": "late", None: "standard"}

    def described(path: str, revision: str | None = None) -> Path:
        folder = tmp_path / str(revision)
        folder.mkdir()
        told = {"type": "obact", "rules": {"control_class": revisions[revision]}}
        (folder / "config.json").write_text(json.dumps(told))
        return folder

    monkeypatch.setattr(command_line, "described_folder", described)
    words = ["lerobot-train", "--policy.path=me/policy"]
    assert said(words).rules["control_class"] == "standard"
    found = said([*words, "--policy.pretrained_revision=v1"])
    assert found.rules["control_class"] == "late"


def test_the_checkpoint_may_be_named_in_a_config_file(said, tmp_path: Path, monkeypatch):
    """That of a training that is resumed names what it began with."""
    checkpoint = tmp_path / "checkpoint"
    checkpoint.mkdir()
    told = {"type": "obact", "rules": {"control_class": "late"}}
    (checkpoint / "config.json").write_text(json.dumps(told))
    (checkpoint / "model.safetensors").write_bytes(b"weights")
    resumed = tmp_path / "train_config.json"
    resumed.write_text(json.dumps({"policy": told | {"pretrained_path": str(checkpoint)}}))
    launch = said(["lerobot-train", f"--config_path={resumed}", "--resume=true"])
    assert (launch.policy, launch.rules["control_class"]) == ("obact", "late")
    # as LeRobot's parser keeps `policy: {path: ...}` of a file
    monkeypatch.setattr(parser, "_config_path_args", {"policy": str(checkpoint)})
    launch = said(["lerobot-eval", "--config_path=eval.yaml"])
    assert (launch.policy, launch.rules["control_class"]) == ("obact", "late")
    assert set(launch.weights) == {"model.safetensors"}


def test_results_go_below_lerobots_output_folder(tmp_path: Path, said) -> None:
    (tmp_path / "act.yaml").write_text("output_dir: outputs/act")
    recipe = f"--config_path={tmp_path / 'act.yaml'}"
    for words in (
        ["--output_dir=out/run"],
        ["--seed", "1", "--output_dir", "out/run", "--env.fps=20"],
    ):
        assert said(["lerobot-eval", *words]).output_dir == Path("out/run")
        assert said(["lerobot-train", recipe, *words]).output_dir == Path("out/run")
    assert said(["lerobot-eval"]).output_dir == Path("outputs")
    launch = said(["lerobot-train", recipe])
    assert launch.results_folder(None).parent == Path("outputs/act/dynahoi")
    assert launch.results_folder("mine").parent == Path("mine")


def test_an_evaluation_replaces_no_results(act: Path, tmp_path: Path) -> None:
    first = through_lerobot(act, tmp_path, "--eval.n_episodes=1", "--eval.batch_size=1")
    with pytest.raises(ValueError, match="holds results; remove it"):
        through_lerobot(act, tmp_path, "--env.task=lob", f"--output_dir={tmp_path / 'second'}")
    assert read_results(tmp_path).rows == first.rows


def test_a_checkpoint_is_played_under_the_rules_it_was_trained_for(tmp_path, monkeypatch, capsys):
    checkpoint = shutil.copytree(SHIPPED, tmp_path / "late")
    edit_json(
        checkpoint / "config.json", lambda config: config["rules"].update(control_class="late")
    )
    monkeypatch.setattr("sys.argv", ["lerobot-eval", f"--policy.path={checkpoint}"])
    config = DynahoiEnvConfig(protocol="direct_act", task="lob", results_dir=str(tmp_path / "out"))
    assert config.features["observation.images.ego"].shape == (128, 128, 3)
    own = config.create_envs(1)["projectile"][0].recipe.rules
    assert (own.control_class, own.image_size, own.protocol) == ("late", 96, "direct_act")
    assert config.features["observation.images.ego"].shape == (96, 96, 3)
    assert "control_class late" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["lerobot-eval"])
    plain = DynahoiEnvConfig(task="lob", image_size=32, results_dir=str(tmp_path / "out"))
    assert plain.create_envs(1)["projectile"][0].recipe.rules.control_class == "standard"


@pytest.fixture(scope="module")
def act(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_act(tmp_path_factory.mktemp("act"), FEATURES["input_features"])


def through_lerobot(policy: Path, out: Path, *words: str) -> Results:
    given = {
        "policy.path": policy,
        "env.type": "dynahoi",
        "env.task": "constant",
        "env.image_size": 32,
        "env.results_dir": out,
        "output_dir": out / "lerobot",
        "seed": 0,
        "eval.batch_size": 2,
        "eval.n_episodes": 2,
        "eval.use_async_envs": False,
    }
    run(["lerobot-eval", *options(given), *words])
    return read_results(out)


def played_here(found: Results, agent: Agent) -> list[Episode]:
    """Our evaluation of the same episodes, in the order of the rows."""
    recipe = found.recipe()
    specs = sample_specs(recipe, [row["seed"] for row in found.rows])
    return played(recipe.rules, agent, specs)


LATE = ("--env.latency_ms=150", "--env.inference=async")


QUEUES = {"act": [], "actor": ["--policy.n_action_steps=6", "--policy.inference_delay=3"]}
"""What a policy is told that plays late, one action a call."""


@pytest.mark.parametrize("policy", QUEUES)
def test_a_policy_with_a_queue_plays_as_with_whole_chunks(
    policy: str, request: pytest.FixtureRequest, tmp_path: Path
):
    """The same actions as by ``dynahoi evaluate --inference async --inference-ms 150``."""
    checkpoint = request.getfixturevalue(policy)
    found = through_lerobot(checkpoint, tmp_path, *LATE, *QUEUES[policy])
    assert found.info.extra["inference"] == "async 150 ms"
    assert len(found.rows) == 2
    late = RealTimeAgent(PolicyAgent(str(checkpoint)), Inference("async", 150.0))
    for actions, episode in zip(found.actions, played_here(found, late), strict=True):
        np.testing.assert_allclose(actions, episode.action, atol=1e-6)
        assert np.ptp(actions, axis=0).max() > 0.01, "the hand moves"


def test_a_policy_with_another_queue_cannot_be_late(act: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="n_action_steps is 5, but the policy's is 8"):
        through_lerobot(act, tmp_path, *LATE, "--env.n_action_steps=5")


def test_without_a_command_line_the_length_of_the_queue_must_be_told():
    late = {"image_size": 32, "inference": "async", "latency_ms": 150.0, "task": "constant"}
    with pytest.raises(ValueError, match="n_action_steps"):
        DynahoiEnvConfig(**late).create_envs(1)
    env = DynahoiEnvConfig(**late, n_action_steps=6).create_envs(1)["straight_line"][0]
    with pytest.raises(ValueError, match="all worlds begin together"):
        env.reset(seed=[0])


FILE = Path(__file__).parents[2] / "envs" / "hub" / "env.py"


def test_lerobot_loads_the_file_and_plays(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = _import_hub_module(str(FILE), "you/dynahoi")
    config = SimpleNamespace(task="lob,pendulum")
    suites = _normalize_hub_result(
        _call_make_env(module, n_envs=2, use_async_envs=False, cfg=config)
    )
    assert {name: len(tasks) for name, tasks in suites.items()} == {"projectile": 1, "pendulum": 3}
    env = suites["projectile"][0]
    observation, _ = env.reset(seed=[0, 1])
    assert observation["pixels"]["ego"].shape[0] == 2
    assert np.isfinite(env.step(observation["agent_pos"])[1]).all()
