"""``dynahoi push``: sound content only, resumed after an interruption, never over something
else.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from huggingface_hub import constants

from dynahoi_lerobot.cli.main import main
from dynahoi_lerobot.dataset import frame_column
from dynahoi_lerobot.evaluate.checkpoint import load_policy
from dynahoi_lerobot.evaluate.policy_agent import PolicyAgent, PolicyError
from dynahoi_lerobot.evaluate.results import METRICS_FILE
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from tests.hub.server import TOKEN, Hub, Repo, serving
from tests.synthetic import run_info, synthetic_episode, write_results
from tests.tools import generated

Push = Callable[..., tuple[int, str, str]]
"""Run ``dynahoi push`` and return its exit code and what it printed on both streams."""


@pytest.fixture
def hub() -> Iterator[Hub]:
    with serving() as hub:
        yield hub


@pytest.fixture
def push(
    hub: Hub, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Push:
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

    def run(*words: object) -> tuple[int, str, str]:
        code = main(["push", *map(str, words)])
        return code, *capsys.readouterr()

    return run


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
    write_results(
        folder,
        [replace(episode, meta=replace(episode.meta, seed=seed, **shown)) for seed in seeds],
        info,
    )
    return folder


ROOT = Path(__file__).parents[2]
DATASET = "datasets/me/catching"
MODEL = "models/me/policy"


def refused(
    answer: tuple[int, str, str], sentence: str, wanted: int = 1, *, in_one_line: bool = True
) -> None:
    """The command ended with an exit code and said why."""
    code, _, err = answer
    assert code == wanted, err
    assert sentence in err
    assert err.count("\n") == 1 or not in_one_line, err


# -- datasets --------------------------------------------------------------------------------------


def test_every_file_arrives_both_tags_are_set_and_pushing_again_changes_nothing(
    simulated: Path, hub: Hub, push: Push
):
    code, out, err = push(simulated, "me/catching", "--private")
    assert code == 0, err
    assert f"{hub.url}/{DATASET}" in out
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
    assert push(simulated, "me/catching", "--private")[0] == 0
    assert list(repo.commits) == commits
    assert not [line for line in hub.requests if line.startswith("PUT")]


@pytest.mark.slow
def test_whoever_fetches_a_dataset_with_lerobot_gets_the_privileged_tables(
    simulated: Path, hub: Hub, push: Push, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata, dataset_metadata
    from lerobot.datasets import lerobot_dataset as whole

    for module in (dataset_metadata, whole):
        monkeypatch.setattr(module, "HF_LEROBOT_HUB_CACHE", tmp_path / "cache")
    monkeypatch.setattr(dataset_metadata, "HF_LEROBOT_HOME", tmp_path / "home")
    assert push(simulated, "me/catching")[0] == 0
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


def test_an_interrupted_upload_goes_on(simulated: Path, hub: Hub, push: Push):
    hub.uploads_left = 2
    refused(push(simulated, "me/catching"), "507 (storage is full)", in_one_line=False)
    assert hub.repos[DATASET].files == {}
    before = set(hub.blobs)
    hub.uploads_left = None
    hub.requests.clear()
    assert push(simulated, "me/catching")[0] == 0
    sent = {line.rpartition("/")[2] for line in hub.requests if line.startswith("PUT")}
    assert len(before) == 2
    assert not sent & before


def test_datasets_that_are_damaged_or_would_overwrite_something_else_are_refused(
    simulated, tmp_path, hub, push
):
    broken = shutil.copytree(simulated, tmp_path / "broken")
    (broken / "meta/tasks.parquet").unlink()
    refused(push(broken, "me/catching"), "tasks.parquet is missing", in_one_line=False)
    assert hub.repos == {}
    push(simulated, "me/catching")
    repo = hub.repos[DATASET]
    refused(push(simulated, "me/catching", "--private"), "is public")
    for sha, held in (
        ("a", repo.files | {"meta/manifest.json": b"{}"}),
        ("b", {"thesis.pdf": b"years of work"}),
    ):
        repo.commits[sha * 40] = held
        refused(push(simulated, "me/catching"), "me/catching holds")
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
def test_tokens_that_will_not_do(repo, token, said, *, checkpoint, hub, push, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", token)
    refused(push(checkpoint, repo), said)
    assert hub.repos == {}


def test_no_network(checkpoint: Path, push: Push, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")
    refused(push(checkpoint, "me/policy"), "http://127.0.0.1:9")


def test_names_folders_and_options_that_do_not_fit(
    checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    for name in ("catching", "a/b/c", "me/a b", ""):
        refused(push(checkpoint, name), repr(name), 2)
    assert hub.requests == []
    (tmp_path / "empty").mkdir()
    refused(push(tmp_path / "empty", "me/catching"), "holds none of these", 2)
    refused(push(checkpoint, "me/policy", "--policy", "me/x"), "--policy", 2)
    (checkpoint / "optimizer.pt").write_bytes(b"pickle")
    refused(push(checkpoint, "me/policy"), "optimizer.pt is a pickle", 2)
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
    config, mode, *, checkpoint, hub, push
):
    (checkpoint / "config.json").write_text(json.dumps(config))
    before = sorted(path.name for path in checkpoint.iterdir())
    assert push(checkpoint, "me/policy")[0] == 0
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
    checkpoint, tmp_path, hub, push
):
    push(checkpoint, "me/policy")
    push(write_split(tmp_path / "results", "test_small", range(110)), "me/policy")
    commits = list(hub.repos[MODEL].commits)
    assert push(checkpoint, "me/policy", "--replace")[0] == 0
    assert list(hub.repos[MODEL].commits) == commits, "the same weights keep their results"
    (checkpoint / "model.safetensors").write_bytes(b"better weights")
    refused(
        push(checkpoint, "me/policy"),
        "me/policy holds other weights (model.safetensors); choose another name",
    )
    assert list(hub.repos[MODEL].commits) == commits
    assert push(checkpoint, "me/policy", "--replace")[0] == 0
    files = hub.repos[MODEL].files
    assert files["model.safetensors"] == b"better weights"
    assert not [name for name in files if "results" in name]


def test_what_our_loader_refuses_is_not_uploaded(
    checkpoint, actor, *, hub, push, monkeypatch, tmp_path
):
    monkeypatch.setattr("dynahoi_lerobot.hub.load_policy", load_policy)
    refused(push(checkpoint, "me/policy"), "model.safetensors cannot be read", 2)
    broken = shutil.copytree(actor, tmp_path / "broken")
    (broken / "policy_preprocessor.json").write_text(
        '{"steps": [{"class": "os.mkdir", "config": {"path": "x"}}]}'
    )
    refused(push(broken, "me/policy"), "'os.mkdir'", 2)
    linked = shutil.copytree(actor, tmp_path / "linked")
    (linked / "notes").symlink_to("/etc/passwd")
    refused(push(linked, "me/policy"), "notes is a link", 2)
    assert hub.repos == {}
    assert push(actor, "me/policy")[0] == 0


def test_results_that_their_commands_do_not_lead_to_are_not_uploaded(
    checkpoint, hub, push, monkeypatch, tmp_path
):
    push(checkpoint, "me/policy")
    monkeypatch.setattr("dynahoi_lerobot.hub.recipe_code", lambda _: "c1")
    refused(
        push(write_split(tmp_path / "results", "ood_speed", range(2)), "me/policy"),
        "was not pushed",
    )
    assert names(hub) == set()


# -- results ---------------------------------------------------------------------------------------


def names(hub: Hub) -> set[str]:
    """Return the names of the result folders in the repository."""
    return {name.split("/")[1] for name in hub.repos[MODEL].files if name.startswith("results/")}


def test_results_need_their_checkpoint_and_must_be_whole(
    checkpoint: Path, tmp_path: Path, hub: Hub, push: Push
):
    results = write_split(tmp_path / "results", "test_small", range(110))
    refused(push(results, "me/policy"), "me/policy holds no checkpoint")
    assert hub.repos == {}
    push(checkpoint, "me/policy")
    (results / "actions.npz").write_bytes(b"")
    assert push(results, "me/policy")[0] == 2
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


def test_results_under_other_rules_or_of_fewer_episodes_have_other_names(
    checkpoint, tmp_path, hub, push
):
    push(checkpoint, "me/policy")
    for number, (options, _) in enumerate(CONDITIONS):
        seeds = options.get("seeds", range(110))
        rest = {k: v for k, v in options.items() if k != "seeds"}
        code, _, err = push(
            write_split(tmp_path / str(number), "test_small", seeds, **rest), "me/policy"
        )
        assert code == 0, err
    assert names(hub) == {name for _, name in CONDITIONS}
    push(
        write_split(tmp_path / "long", "test_small", range(2), extra={"settings": ["x" * 300]}),
        "me/policy",
    )
    assert max(map(len, names(hub))) == 120


@pytest.mark.parametrize("policy", ["you/other", "intercept", "outputs/gone/pretrained_model"])
def test_results_of_another_policy_are_refused_unless_said_to_be_of_this_one(
    policy, checkpoint, tmp_path, hub, push
):
    push(checkpoint, "me/policy")
    results = write_split(tmp_path / "results", "ood_speed", range(2), policy=policy)
    for said in ([], ["--policy", "you/third"]):
        refused(push(results, "me/policy", *said), f"{results} is of {policy}")
    assert names(hub) == set()
    assert push(results, "me/policy", "--policy", policy)[0] == 0


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
    weights: dict[str, str], code: int, checkpoint: Path, tmp_path: Path, push: Push
):
    push(checkpoint, "me/policy")
    digest = hashlib.sha256((checkpoint / "model.safetensors").read_bytes()).hexdigest()
    named = {name: value.replace("its own", digest) for name, value in weights.items()}
    results = write_split(tmp_path / "results", "ood_speed", range(2), extra={"weights": named})
    assert push(results, "me/policy")[0] == code


def test_the_card_lists_the_results_once(checkpoint: Path, tmp_path: Path, hub: Hub, push: Push):
    push(checkpoint, "me/policy")
    results = write_split(tmp_path / "results", "test_small", range(110))
    assert push(results, "me/policy")[0] == 0
    commits = list(hub.repos[MODEL].commits)
    assert push(results, "me/policy")[0] == 0
    assert list(hub.repos[MODEL].commits) == commits
    _, head, body = hub.repos[MODEL].files["README.md"].decode().split("---\n", 2)
    (model,) = yaml.safe_load(head)["model-index"]
    (entry,) = model["results"]
    assert body.count("> The results `") == 1
    assert entry["dataset"]["split"] == "test_small"
    assert {metric["type"] for metric in entry["metrics"]} == {"S_loc", "S_joint"}


@pytest.mark.slow
def test_a_checkpoint_is_evaluated_by_its_name_and_its_results_stand_beside_it(
    hub: Hub, push: Push, tmp_path: Path
):
    results = tmp_path / "results"
    assert push(ROOT / "checkpoints/obact_standard", "me/policy")[0] == 0
    assert (
        main(["evaluate", "--policy", "me/policy", "--episodes", "2", "--out", str(results)]) == 0
    )
    assert push(results, "me/policy")[0] == 0
    files = hub.repos[MODEL].files
    head = json.loads((results / METRICS_FILE).read_text())
    assert "model.safetensors" in files
    name = f"{BENCHMARK_ID}_test_small_attach_standard_image_size_96_2_episodes"
    assert json.loads(files[f"results/{name}/{METRICS_FILE}"]) == head
    assert push(ROOT / "checkpoints/obact_standard", "me/policy")[0] == 0, (
        "results beside it are no obstacle"
    )


@pytest.mark.usefixtures("push")
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
    hub: Hub, push: Push, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    from lerobot.envs.factory import make_env

    monkeypatch.chdir(tmp_path)
    code, out, err = push(ROOT / "envs/hub", "me/dynahoi-env")
    assert code == 0, err
    assert f"environment pushed to {hub.url}/me/dynahoi-env" in out
    suites = make_env("me/dynahoi-env", n_envs=1, trust_remote_code=True)
    (env,) = [env for suite in suites.values() for env in suite.values() if env.task == "lob"]
    observation, _ = env.reset(seed=[0])
    assert observation["agent_pos"].shape == (1, 18)
