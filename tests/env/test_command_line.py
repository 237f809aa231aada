"""What is wrong with LeRobot's command line is said in one sentence, before LeRobot loads anything
else.
"""

import sys

import lerobot_env_dynahoi.checks
import lerobot_robot_dynahoi.checks
import pytest

from tests.checkpoints import SHIPPED

EVAL = "/bin/lerobot-eval --env.type=dynahoi"
TELEOPERATE = "lerobot-teleoperate --robot.type=dynahoi"
ROLLOUT = "lerobot-rollout --robot.type=dynahoi"
RECORD = "lerobot-record --robot.type=dynahoi --dataset.repo_id=local/x"


def check(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let both plugins look at a command line, as they do when LeRobot imports them."""
    monkeypatch.setattr(sys, "argv", command.split())
    lerobot_env_dynahoi.checks.check_command_line()
    lerobot_robot_dynahoi.checks.check_command_line()


@pytest.mark.parametrize(
    ("command", "named"),
    [
        (f"{EVAL} --env.task=lobb", "unknown task 'lobb' (did you mean 'lob'?)"),
        (f"{EVAL} --env.hand=claw", "'claw'"),
        (f"{EVAL} --env.image_size=-3", "-3"),
        (f"{EVAL} --env.max_parallel_tasks=2", "got 2"),
        (f"{EVAL} --env.fps=30", "env.fps must be 20"),
        (f"{EVAL} --env.disable_env_checker=false", "env.disable_env_checker must be true"),
        (f"{EVAL} --env.features {{}}", "env.features cannot be set"),
        (f"{EVAL} --env.n_action_steps=4", "env.n_action_steps is read with env.inference=async"),
        (f"{EVAL} --env.latency_ms=150", "with mode sync the world waits"),
        (f"{EVAL} --policy.path=no/such/folder", "'no/such/folder'"),
        (f"{EVAL} --policy.path={SHIPPED.parent}", "holds no policy"),
        (f"{EVAL} --env.results_dir=RESULTS", "holds results; remove it"),
        (RECORD, "dataset.fps must be 20"),
        (f"{RECORD} --dataset.fps=30", "but is 30"),
        (ROLLOUT, "fps must be 20"),
        (f"{ROLLOUT} --fps 30", "but is 30"),
        (f"{ROLLOUT} --fps=20 --dataset.repo_id=local/x", "dataset.fps must be 20"),
        (f"{TELEOPERATE} --robot.task=lobb", "'lobb'"),
    ],
)
def test_a_mistake_is_one_sentence(command: str, named: str, *, monkeypatch, capsys, tmp_path):
    (tmp_path / "metrics.json").touch()
    command = command.replace("RESULTS", str(tmp_path))
    with pytest.raises(SystemExit) as end:
        check(command, monkeypatch)
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert named in said
    assert said.startswith(f"{command.split(maxsplit=1)[0].removeprefix('/bin/')}: ")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    "command",
    [
        "pytest --env.task=nothing",
        "lerobot-eval --env.type=pusht --env.task=nothing",
        f"{EVAL} --env.task=lob --policy.path={SHIPPED}",
        'lerobot-eval --env.type dynahoi --env.views ["side"]',
        f"{EVAL} --env.discover_packages_path my_motions",
        f"{RECORD} --dataset.fps=20",
        f"{ROLLOUT} --fps=20.0",
        f"{ROLLOUT} --robot.realtime=false --fps=200",
        f"{TELEOPERATE} --fps=60",
        "lerobot-record --robot.type=so101_follower --dataset.repo_id=local/x",
    ],
)
def test_other_commands_and_good_options_pass(command: str, monkeypatch) -> None:
    check(command, monkeypatch)
