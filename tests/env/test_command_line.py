"""What is wrong with LeRobot's command line is said in one sentence, before LeRobot loads anything
else.
"""

import sys

import pytest
from lerobot_env_dynahoi.checks import check_command_line

from tests.checkpoints import SHIPPED


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--env.task=lobb"], "unknown task 'lobb' (did you mean 'lob'?)"),
        (["--env.hand=claw"], "'claw'"),
        (["--env.image_size=-3"], "-3"),
        (["--env.max_parallel_tasks=2"], "got 2"),
        (["--env.fps=30"], "env.fps must be 20"),
        (["--env.disable_env_checker=false"], "env.disable_env_checker must be true"),
        (["--env.features", "{}"], "env.features cannot be set"),
        (["--env.n_action_steps=4"], "env.n_action_steps is read with env.inference=async"),
        (["--env.latency_ms=150"], "with mode sync the world waits"),
        (["--policy.path=no/such/folder"], "'no/such/folder'"),
        ([f"--policy.path={SHIPPED.parent}"], "holds no policy"),
    ],
)
def test_a_mistake_is_one_sentence(words: list[str], named: str, refusal) -> None:
    command = ["/bin/lerobot-eval", "--env.type=dynahoi", *words]
    assert named in refusal(check_command_line, command)


@pytest.mark.parametrize(
    "words",
    [
        ["pytest", "--env.task=nothing"],
        ["lerobot-eval", "--env.type=pusht", "--env.task=nothing"],
        ["lerobot-eval", "--env.type=dynahoi", "--env.task=lob", f"--policy.path={SHIPPED}"],
        ["lerobot-eval", "--env.type", "dynahoi", "--env.views", '["side"]'],
        ["lerobot-eval", "--env.type=dynahoi", "--env.discover_packages_path", "my_motions"],
    ],
)
def test_other_environments_and_good_options_pass(words: list[str], monkeypatch) -> None:
    monkeypatch.setattr(sys, "argv", words)
    check_command_line()
