"""``dynahoi push``: sound content only, resumed after an interruption, never over something
else.
"""

import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from huggingface_hub import constants

from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.dataset import frame_column
from dynahoi_lerobot.evaluate.checkpoint import load_policy
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent, PolicyError
from dynahoi_lerobot.evaluate.results import METRICS_FILE
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from tests.hub.server import TOKEN, Hub, Repo, serving
from tests.synthetic import run_info, synthetic_episode, write_results
from tests.tools import dynahoi, generated


@pytest.fixture(autouse=True)
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    """A Hub in memory, which the client takes for the real one."""
    with serving() as hub:
        template = constants.HUGGINGFACE_CO_URL_TEMPLATE.replace(constants.ENDPOINT, hub.url)
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setattr(constants, "ENDPOINT", hub.url)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub_cache"))
        monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no_token"))
        monkeypatch.setattr(
            constants, "HF_HUB_DISABLE_XET", True
        )  # the server has only the large file storage
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        monkeypatch.setattr(
            "dynahoi_lerobot.hub.load_policy", lambda *_, **__: None
        )  # most checkpoints here are stubs
        yield hub


push = partial(dynahoi, "push")


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generated(tmp_path_factory.mktemp("hub") / "dataset", "--image-size", "32")


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    folder = tmp_path / "pretrained_model"
    (folder / "training_state").mkdir(parents=True)
    (folder / "training_state/rng.safetensors").write_bytes(b"state")
    (folder / "config.json").write_text(json.dumps({"type": "obact"}))
    (folder / "model.safetensors").write_bytes(b"weights")
    (folder / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": "me/catching"}}))
    return folder


def write_split(
    folder: Path,
    split: str,
    seeds: Iterable[int],
    *,
    policy: str = "me/policy",
    command: str = "dynahoi evaluate",
    extra: dict | None = None,
    **recipe: object,
) -> Path:
    """Write the results of episodes that all are the same but for their seeds."""
    episode = synthetic_episode(0, image_size=None)
    info = run_info(policy, command=command, extra=extra, split=split, **recipe)
    shown = {name: recipe[name] for name in ("protocol",) if name in recipe}
    write_results(folder, [changed(episode, shown | {"seed": seed}) for seed in seeds], info)
    return folder


ROOT = Path(__file__).parents[2]
DATASET = "datasets/me/catching"
MODEL = "models/me/policy"


def refused(sentence: str, *words: object, code: int = 1, in_one_line: bool = True) -> None:
    """A push must end with an exit code and say why."""
    said = push(*words, code=code).err
    assert sentence in said
    assert said.count("\n") == 1 or not in_one_line, said


# -- datasets --------------------------------------------------------------------------------------


def test_every_file_arrives_both_tags_are_set_and_pushing_again_changes_nothing(
    simulated: Path, hub: Hub
):
    assert f"{hub.url}/{DATASET}" in push(simulated, "me/catching", "--private").out
    repo = hub.repos[DATASET]
    assert repo.private
    assert {name: len(content) for name, content in repo.files.items()} == {
        path.relative_to(simulated).as_posix(): path.stat().st_size
        for path in simulated.rglob("*")
        if path.is_file()
    }
    assert repo.tags == {"v3.0": repo.head, f"dynahoi-{BENCHMARK_ID}": repo.head}
    commits = list(repo.commits)
    hub.requests.clear()
    push(simulated, "me/catching", "--private")
    assert list(repo.commits) == commits
    assert not [line for line in hub.requests if line.startswith("PUT")]


@pytest.mark.slow
def test_whoever_fetches_a_dataset_with_lerobot_gets_the_privileged_tables(
    simulated: Path, hub: Hub, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata, dataset_metadata
    from lerobot.datasets import lerobot_dataset as whole

    for module in (dataset_metadata, whole):
        monkeypatch.setattr(module, "HF_LEROBOT_HUB_CACHE", tmp_path / "cache")
    monkeypatch.setattr(dataset_metadata, "HF_LEROBOT_HOME", tmp_path / "home")
    push(simulated, "me/catching")
    wanted = frame_column(simulated, "target.pose")
    for fetch in (
        lambda: LeRobotDataset("me/catching", episodes=[0]),
        lambda: LeRobotDataset("me/catching", root=tmp_path / "some", episodes=[1]),
        lambda: LeRobotDataset("me/catching", root=tmp_path / "all"),
        # all that a streaming dataset keeps on this disk
        lambda: LeRobotDatasetMetadata("me/catching", root=tmp_path / "streamed"),
    ):
        np.testing.assert_array_equal(frame_column(fetch().root, "target.pose"), wanted)
    assert not (tmp_path / "streamed/data").exists()


def test_an_interrupted_upload_goes_on(simulated: Path, hub: Hub):
    hub.uploads_left = 2
    refused("507 (storage is full)", simulated, "me/catching", in_one_line=False)
    assert hub.repos[DATASET].files == {}
    before = set(hub.blobs)
    hub.uploads_left = None
    hub.requests.clear()
    push(simulated, "me/catching")
    sent = {line.rpartition("/")[2] for line in hub.requests if line.startswith("PUT")}
    assert len(before) == 2
    assert not sent & before


def test_ctrl_c_says_that_an_upload_can_be_resumed(simulated: Path, hub: Hub, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("dynahoi_lerobot.hub.Repository.upload", stop)
    refused("interrupted; run the same command to resume", simulated, "me/catching", code=130)


def test_datasets_that_are_damaged_or_would_overwrite_something_else_are_refused(
    simulated, tmp_path, hub
):
    broken = shutil.copytree(simulated, tmp_path / "broken")
    (broken / "meta/tasks.parquet").unlink()
    refused("tasks.parquet is missing", broken, "me/catching", in_one_line=False)
    assert hub.repos == {}
    push(simulated, "me/catching")
    repo = hub.repos[DATASET]
    refused("is public", simulated, "me/catching", "--private")
    for sha, held in (
        ("a", repo.files | {"meta/manifest.json": b"{}"}),
        ("b", {"thesis.pdf": b"years of work"}),
    ):
        repo.commits[sha * 40] = held
        refused("me/catching holds", simulated, "me/catching")
        assert repo.files == held


# -- what any push needs ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("repo", "token", "said"),
    [
        ("me/catching", "hf_" + "wrong" * 6, "rejected the token"),
        ("me/catching", "", "no Hub token"),
        ("you/catching", TOKEN, "you/catching"),
    ],
)
def test_tokens_that_will_not_do(repo, token, said, *, checkpoint, hub, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", token)
    refused(said, checkpoint, repo)
    assert hub.repos == {}


def test_no_network(checkpoint: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")
    refused("http://127.0.0.1:9", checkpoint, "me/policy")


def test_names_folders_and_options_that_do_not_fit(checkpoint: Path, tmp_path: Path, hub: Hub):
    for name in ("catching", "a/b/c", "me/a b", ""):
        refused(repr(name), checkpoint, name, code=2)
    assert hub.requests == []
    (tmp_path / "empty").mkdir()
    refused("holds none of these", tmp_path / "empty", "me/catching", code=2)
    refused("--policy", checkpoint, "me/policy", "--policy", "me/x", code=2)
    (checkpoint / "optimizer.pt").write_bytes(b"pickle")
    refused("optimizer.pt is a pickle", checkpoint, "me/policy", code=2)
    assert hub.repos == {}


# -- checkpoints -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "mode"),
    [
        ({"type": "obact"}, "joints"),
        ({"type": "act", "rules": {"control_mode": "grasp"}}, "grasp"),
    ],
)
def test_a_checkpoint_without_a_card_gets_one_and_a_card_that_is_there_stays(
    config, mode, *, checkpoint, hub
):
    (checkpoint / "config.json").write_text(json.dumps(config))
    before = sorted(path.name for path in checkpoint.iterdir())
    push(checkpoint, "me/policy")
    assert sorted(path.name for path in checkpoint.iterdir()) == before
    files = hub.repos[MODEL].files
    assert set(files) == {"README.md", "config.json", "model.safetensors", "train_config.json"}
    _, head, body = files["README.md"].decode().split("---\n", 2)
    metadata = yaml.safe_load(head)
    assert (metadata["library_name"], metadata["datasets"]) == ("lerobot", ["me/catching"])
    assert "dynahoi evaluate --policy me/policy" in body
    assert f"control_mode `{mode}`" in body
    assert ("lerobot_policy_obact" in body) == (config["type"] == "obact"), "what it needs"
    files["README.md"] = b"edited on the Hub"
    push(checkpoint, "me/policy")
    assert hub.repos[MODEL].files["README.md"] == b"edited on the Hub"
    (checkpoint / "README.md").write_text("mine")
    push(checkpoint, "me/policy")
    assert hub.repos[MODEL].files["README.md"] == b"mine"


def test_other_weights_replace_the_old_ones_and_their_results_only_if_that_is_asked(
    checkpoint, tmp_path, hub
):
    push(checkpoint, "me/policy")
    push(write_split(tmp_path / "results", "test_small", range(110)), "me/policy")
    commits = list(hub.repos[MODEL].commits)
    push(checkpoint, "me/policy", "--replace")
    assert list(hub.repos[MODEL].commits) == commits, "the same weights keep their results"
    (checkpoint / "model.safetensors").write_bytes(b"better weights")
    refused(
        "me/policy holds other weights (model.safetensors); choose another name",
        checkpoint,
        "me/policy",
    )
    assert list(hub.repos[MODEL].commits) == commits
    push(checkpoint, "me/policy", "--replace")
    files = hub.repos[MODEL].files
    assert files["model.safetensors"] == b"better weights"
    assert not [name for name in files if "results" in name]


def test_what_our_loader_refuses_is_not_uploaded(checkpoint, actor, *, hub, monkeypatch, tmp_path):
    monkeypatch.setattr("dynahoi_lerobot.hub.load_policy", load_policy)
    refused("model.safetensors cannot be read", checkpoint, "me/policy", code=2)
    broken = shutil.copytree(actor, tmp_path / "broken")
    (broken / "policy_preprocessor.json").write_text(
        '{"steps": [{"class": "os.mkdir", "config": {"path": "x"}}]}'
    )
    refused("'os.mkdir'", broken, "me/policy", code=2)
    linked = shutil.copytree(actor, tmp_path / "linked")
    (linked / "notes").symlink_to("/etc/passwd")
    refused("notes is a link", linked, "me/policy", code=2)
    assert hub.repos == {}
    push(actor, "me/policy")


def test_results_that_their_commands_do_not_lead_to_are_not_uploaded(
    checkpoint, hub, monkeypatch, tmp_path
):
    push(checkpoint, "me/policy")
    monkeypatch.setattr("dynahoi_lerobot.hub.recipe_code", lambda _: "c1")
    refused("was not pushed", write_split(tmp_path / "results", "ood_speed", range(2)), "me/policy")
    assert names(hub) == set()


# -- results ---------------------------------------------------------------------------------------


def names(hub: Hub) -> set[str]:
    """Return the names of the result folders in the repository."""
    return {name.split("/")[1] for name in hub.repos[MODEL].files if name.startswith("results/")}


def test_results_need_their_checkpoint_and_must_be_whole(
    checkpoint: Path, tmp_path: Path, hub: Hub
):
    results = write_split(tmp_path / "results", "test_small", range(110))
    refused("me/policy holds no checkpoint", results, "me/policy")
    assert hub.repos == {}
    push(checkpoint, "me/policy")
    (results / "actions.npz").write_bytes(b"")
    push(results, "me/policy", code=2)
    assert names(hub) == set()


WHOLE = f"{BENCHMARK_ID}_test_small_attach_standard"
CONDITIONS: list[tuple[dict, str]] = [
    ({}, WHOLE),
    ({"protocol": "occluded"}, f"{WHOLE}_protocol_occluded"),
    ({"objects": ("ball", "cup")}, f"{WHOLE}_objects_ball_cup"),
    ({"extra": {"inference": "async 150 ms"}}, f"{WHOLE}_async_150_ms"),
    ({"extra": {"settings": ["n_action_steps=-1"]}}, f"{WHOLE}_n_action_steps_-1"),
    ({"seeds": range(3), "protocol": "occluded"}, f"{WHOLE}_protocol_occluded_3_episodes"),
]


def test_results_under_other_rules_or_of_fewer_episodes_have_other_names(checkpoint, tmp_path, hub):
    push(checkpoint, "me/policy")
    for number, (options, _) in enumerate(CONDITIONS):
        seeds = options.get("seeds", range(110))
        rest = {k: v for k, v in options.items() if k != "seeds"}
        push(write_split(tmp_path / str(number), "test_small", seeds, **rest), "me/policy")
    assert names(hub) == {name for _, name in CONDITIONS}
    push(
        write_split(tmp_path / "long", "test_small", range(2), extra={"settings": ["x" * 300]}),
        "me/policy",
    )
    assert max(map(len, names(hub))) == 120


@pytest.mark.parametrize("policy", ["you/other", "intercept", "outputs/gone/pretrained_model"])
def test_results_of_another_policy_are_refused_unless_said_to_be_of_this_one(
    policy, checkpoint, tmp_path, hub
):
    push(checkpoint, "me/policy")
    results = write_split(tmp_path / "results", "ood_speed", range(2), policy=policy)
    for said in ([], ["--policy", "you/third"]):
        refused(f"{results} is of {policy}", results, "me/policy", *said)
    assert names(hub) == set()
    push(results, "me/policy", "--policy", policy)


@pytest.mark.parametrize(
    ("weights", "code"),
    [
        ({"model.safetensors": "its own"}, 0),
        ({"model.safetensors": "0a" * 32}, 1),
        ({"model.safetensors": "its own", "base/model.safetensors": "0b" * 32}, 0),
        ({"base/model.safetensors": "0b" * 32}, 1),
    ],
    ids=["its own", "others", "of an adapter", "of its base alone"],
)
def test_results_go_to_the_repository_with_the_weights_that_they_name(
    weights: dict[str, str], code: int, checkpoint: Path, tmp_path: Path
):
    push(checkpoint, "me/policy")
    digest = hashlib.sha256((checkpoint / "model.safetensors").read_bytes()).hexdigest()
    named = {name: value.replace("its own", digest) for name, value in weights.items()}
    results = write_split(tmp_path / "results", "ood_speed", range(2), extra={"weights": named})
    push(results, "me/policy", code=code)


def test_the_card_lists_the_results_once(checkpoint: Path, tmp_path: Path, hub: Hub):
    push(checkpoint, "me/policy")
    results = write_split(tmp_path / "results", "test_small", range(110))
    push(results, "me/policy")
    commits = list(hub.repos[MODEL].commits)
    push(results, "me/policy")
    assert list(hub.repos[MODEL].commits) == commits
    _, head, body = hub.repos[MODEL].files["README.md"].decode().split("---\n", 2)
    (model,) = yaml.safe_load(head)["model-index"]
    (entry,) = model["results"]
    assert body.count("> The results `") == 1
    assert entry["dataset"]["split"] == "test_small"
    assert {metric["type"] for metric in entry["metrics"]} == {"S_loc", "S_joint"}


@pytest.mark.slow
def test_a_checkpoint_is_evaluated_by_its_name_and_its_results_stand_beside_it(
    hub: Hub, tmp_path: Path
):
    results = tmp_path / "results"
    push(ROOT / "checkpoints/obact_standard", "me/policy")
    dynahoi("evaluate", "--policy", "me/policy", "--episodes", "2", "--out", results)
    push(results, "me/policy")
    files = hub.repos[MODEL].files
    head = json.loads((results / METRICS_FILE).read_text())
    assert "model.safetensors" in files
    name = f"{BENCHMARK_ID}_test_small_attach_standard_image_size_96_2_episodes"
    assert json.loads(files[f"results/{name}/{METRICS_FILE}"]) == head
    push(ROOT / "checkpoints/obact_standard", "me/policy")  # results beside it are no obstacle


def test_a_repository_is_checked_before_its_weights_are_fetched_of_the_same_commit(
    actor: Path, hub: Hub
):
    harmless = {path.name: path.read_bytes() for path in actor.iterdir()} | {
        "optimizer.pt": b"never fetched"
    }
    program = {
        "policy_preprocessor.json": b'{"steps": [{"class": "os.mkdir", "config": {"path": "x"}}]}'
    }
    repo = hub.repos[MODEL] = Repo(private=False, commits={"a" * 40: harmless | program})

    class Requests(list[str]):
        """Lets somebody commit another program when a file is asked for."""

        def append(self, line: str) -> None:
            super().append(line)
            if "/resolve/" in line:
                repo.commits["c" * 40] = harmless | program

        def fetched(self) -> set[tuple[str, str]]:
            return {
                (commit, name)
                for *_, commit, name in (x.split("/") for x in self if "/resolve/" in x)
            }

    hub.requests = requests = Requests()
    with pytest.raises(PolicyError, match=r"os\.mkdir"):
        PolicyAgent("me/policy")
    assert requests.fetched() == {("a" * 40, name) for name in harmless if name.endswith(".json")}
    repo.commits = {"b" * 40: harmless}
    hub.requests = requests = Requests()
    agent = PolicyAgent("me/policy")
    assert (agent.name, agent.trained_for["image_size"]) == ("me/policy", 32)
    assert requests.fetched() == {("b" * 40, name) for name in harmless if name != "optimizer.pt"}


def test_lerobot_makes_the_environment_that_was_pushed(
    hub: Hub, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    from lerobot.envs.factory import make_env

    monkeypatch.chdir(tmp_path)
    said = push(ROOT / "envs/hub", "me/dynahoi-env").out
    assert f"environment pushed to {hub.url}/me/dynahoi-env" in said
    suites = make_env("me/dynahoi-env", n_envs=1, trust_remote_code=True)
    (env,) = [env for suite in suites.values() for env in suite.values() if env.task == "lob"]
    observation, _ = env.reset(seed=[0])
    assert observation["agent_pos"].shape == (1, 18)
