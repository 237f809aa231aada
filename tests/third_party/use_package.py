"""Play the task, the metric and the policy of an installed package by their names, in commands.

python -m tests.third_party.use_package FOLDER
"""

import sys
from pathlib import Path

from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

from dynahoi_lerobot.cli.main import BAD_INPUT
from tests.tools import dynahoi, generated, lerobot_train, options, run


def main(folder: Path) -> None:
    assert "a_drift" not in DynahoiEnvConfig(task="straight_line").recipe().motion_names
    assert DynahoiEnvConfig(task="a_drift,lob").recipe().motions == ("lob", "a_drift")
    data = generated(folder / "data", "--image-size", "0", "--motions", "a_drift")
    dynahoi("verify", data)
    policy = lerobot_train(data, folder / "trained", {"type": "forward"}, env_eval_freq=0)
    evaluate = ["evaluate", "--policy", policy, "--out", folder / "results"]
    evaluate += ["--motions", "a_drift", "--episodes", "2"]
    dynahoi(*evaluate, code=BAD_INPUT)  # a policy that is not on the list needs --trust
    dynahoi(*evaluate, "--trust")
    played = {
        "policy.path": policy,
        "env.type": "dynahoi",
        "env.task": "a_drift",
        "env.image_size": 32,
        "env.results_dir": folder / "in_lerobot",
        "output_dir": folder / "evaluated",
        "eval.batch_size": 2,
        "eval.n_episodes": 2,
    }
    run(["lerobot-eval", *options(played)])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
