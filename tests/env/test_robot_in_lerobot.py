"""LeRobot's own commands on the simulated hand, as they are typed but for their times."""

import sys
import threading
import time
from pathlib import Path

import pytest
from lerobot.async_inference.configs import RobotClientConfig
from lerobot.async_inference.robot_client import RobotClient
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_tools import merge_datasets, remove_feature
from lerobot.rollout.strategies import dagger
from lerobot_policy_obact import ObActPolicy, launch_policy_server
from lerobot_robot_dynahoi import DynahoiRobotConfig

from dynahoi_lerobot.evaluate.results import METRICS_FILE, Results, read_results
from tests.tools import generated, run

ROBOT = (
    "--robot.type=dynahoi",
    "--robot.realtime=false",
    "--robot.task=constant",
    "--robot.image_size=32",
)
EXPERT = "--teleop.type=dynahoi_expert"
TASK = "Catch the object."


@pytest.fixture
def lerobot(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Run one of LeRobot's console scripts in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda name, *words: run([f"lerobot-{name}", *words])


def recording(name: str, episodes: int = 1, seconds: float = 1.0) -> list[str]:
    """Options that record a dataset in folder ``name``."""
    told = {
        "repo_id": f"local/{name}",
        "root": name,
        "fps": 20,
        "single_task": TASK,
        "num_episodes": episodes,
    }
    told |= {
        "episode_time_s": seconds,
        "reset_time_s": 0,
        "push_to_hub": "false",
        "rgb_encoder.vcodec": "h264",
    }
    return [*(f"--dataset.{key}={value}" for key, value in told.items()), "--play_sounds=false"]


def rollout(actor: Path, strategy: str) -> list[str]:
    """Options of a rollout that plays faster than the clock."""
    return [
        f"--policy.path={actor}",
        f"--strategy.type={strategy}",
        "--fps=200",
        "--return_to_initial_position=false",
    ]


def test_the_expert_teleoperates(lerobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write = Results.write

    def stop_after_two(results: Results) -> None:
        write(results)
        if len(results.rows) == 2:
            monkeypatch.setattr(Results, "write", write)
            raise KeyboardInterrupt

    monkeypatch.setattr(Results, "write", stop_after_two)
    options = ("--robot.restart_s=0", "--robot.results_dir=r", "--fps=500", "--teleop_time_s=120")
    lerobot("teleoperate", *ROBOT, EXPERT, *options)
    rows = read_results(tmp_path / "r").rows
    assert [row["success"] for row in rows] == [True, True]


def test_a_generated_episode_is_replayed_and_caught(lerobot, tmp_path: Path):
    generated(tmp_path / "data", "--image-size", "32", episodes=1)
    lerobot(
        "replay",
        "--robot.type=dynahoi",
        "--robot.realtime=false",
        "--robot.split=train",
        "--robot.results_dir=r",
        "--dataset.repo_id=local/data",
        "--dataset.root=data",
        "--dataset.episode=0",
        "--play_sounds=false",
    )
    [row] = read_results(tmp_path / "r").rows
    assert row["success"]


@pytest.mark.nightly
@pytest.mark.slow
def test_recordings_merge_with_generated_datasets_and_can_be_trained_on(lerobot, tmp_path: Path):
    lerobot("record", *ROBOT, EXPERT, *recording("demos", episodes=2))
    ours = LeRobotDataset(
        "local/data", root=generated(tmp_path / "data", "--image-size", "32", episodes=1)
    )
    recorded = LeRobotDataset("local/demos", root=tmp_path / "demos")
    assert recorded.num_episodes == 2
    extra = sorted(set(ours.features) - set(recorded.features))
    ours = remove_feature(ours, extra, output_dir=tmp_path / "bare", repo_id="local/bare")
    both = merge_datasets(
        [ours, recorded], "local/both", tmp_path / "both", concatenate_videos=False
    )
    assert both.num_episodes == 3
    lerobot(
        "train",
        "--dataset.repo_id=local/both",
        "--dataset.root=both",
        "--policy.type=act",
        "--steps=1",
        "--policy.push_to_hub=false",
        "--batch_size=2",
        "--num_workers=0",
        "--policy.dim_model=32",
        "--policy.n_heads=2",
        "--policy.pretrained_backbone_weights=null",
        "--output_dir=out",
    )


@pytest.mark.nightly
@pytest.mark.slow
def test_a_policy_is_rolled_out_episode_by_episode(lerobot, actor: Path, tmp_path: Path):
    lerobot(
        "rollout",
        *ROBOT,
        *rollout(actor, "episodic"),
        *recording("rollout_it", episodes=2, seconds=4),
        "--strategy.reset_to_initial_position=false",
        "--robot.results_dir=r",
        "--dataset.reset_time_s=1.1",
    )
    assert LeRobotDataset("local/rollout_it", root=tmp_path / "rollout_it").num_episodes == 2
    assert len({row["seed"] for row in read_results(tmp_path / "r").rows}) == 2


@pytest.mark.nightly
@pytest.mark.slow
def test_a_policy_is_rolled_out_with_real_time_chunking(lerobot, actor: Path, tmp_path: Path):
    lerobot(
        "rollout",
        *ROBOT,
        *rollout(actor, "episodic"),
        *recording("rollout_rtc", seconds=3),
        "--fps=20",
        "--inference.type=rtc",
    )
    assert LeRobotDataset("local/rollout_rtc", root=tmp_path / "rollout_rtc").num_frames > 0, (
        "only actions count"
    )


@pytest.mark.nightly
@pytest.mark.slow
def test_a_policy_is_rolled_out_and_nothing_recorded(lerobot, actor: Path, tmp_path: Path):
    lerobot(
        "rollout",
        *ROBOT,
        *rollout(actor, "base"),
        f"--task={TASK}",
        "--duration=4",
        "--robot.results_dir=r",
    )
    assert len(read_results(tmp_path / "r").rows) == 1, (
        "the world waits for LeRobot to begin another episode"
    )


@pytest.mark.nightly
@pytest.mark.slow
def test_the_expert_corrects_a_policy(
    lerobot, actor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    class Keys(threading.Thread):
        """A person who pauses the policy, corrects it and ends the correction."""

        def __init__(self, dispatch, controls_help: str) -> None:
            super().__init__(daemon=True)
            self.dispatch = dispatch
            self.over = threading.Event()
            self.start()

        def run(self) -> None:
            for key in ("", "space", "tab", "tab"):
                self.dispatch(key)
                self.over.wait(1.0)

        def stop(self) -> None:
            self.over.set()

    monkeypatch.setattr(dagger, "create_key_listener", Keys)
    lerobot("rollout", *ROBOT, *rollout(actor, "dagger"), *recording("rollout_dagger"), EXPERT,
            "--strategy.smooth_handover=false")  # fmt: skip
    corrections = LeRobotDataset("local/rollout_dagger", root=tmp_path / "rollout_dagger")
    assert corrections.num_episodes == 1
    assert all(corrections.hf_dataset["intervention"])


@pytest.mark.nightly
@pytest.mark.slow
def test_a_policy_server_moves_it(actor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    port = "50917"
    monkeypatch.setattr(ObActPolicy, "real_time", True)  # which the server sets, for this test only
    monkeypatch.setattr(sys, "argv", ["server", "--host=127.0.0.1", f"--port={port}", "--fps=100"])
    threading.Thread(target=launch_policy_server.main, daemon=True).start()
    options = {"realtime": False, "restart_s": float("inf"), "results_dir": tmp_path / "r"}
    config = DynahoiRobotConfig(task="constant", image_size=32, **options)
    client = RobotClient(
        RobotClientConfig("obact", str(actor), config, 4, TASK, f"127.0.0.1:{port}", fps=100)
    )
    assert client.start()
    receiver = threading.Thread(target=client.receive_actions, daemon=True)
    receiver.start()
    threading.Thread(target=client.control_loop, args=(TASK,), daemon=True).start()
    while not (tmp_path / "r" / METRICS_FILE).exists():
        time.sleep(0.1)
    client.stop()
    assert len(read_results(tmp_path / "r").rows) == 1
