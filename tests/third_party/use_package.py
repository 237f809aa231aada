"""Play the task, the metric and the policy of an installed package by their names, in commands.

python -m tests.third_party.use_package FOLDER
"""

import sys
from pathlib import Path

from lerobot.scripts.lerobot_eval import main as lerobot_eval
from lerobot.scripts.lerobot_train import main as lerobot_train
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

from dynahoi_lerobot.cli.main import BAD_INPUT
from dynahoi_lerobot.cli.main import main as dynahoi


def lerobot(command, **options: object) -> None:
    words = [f"--{name.replace('__', '.')}={value}" for name, value in options.items()]
    sys.argv = [command.__name__, *words]
    command()


def main(folder: Path) -> None:
    data = folder / "data"
    policy = folder / "trained/checkpoints/last/pretrained_model"
    assert "a_drift" not in DynahoiEnvConfig(task="straight_line").recipe().motion_names
    assert DynahoiEnvConfig(task="a_drift,lob").recipe().motions == ("lob", "a_drift")
    drift = ["--motions", "a_drift", "--episodes", "2"]
    assert dynahoi(["generate", "--root", str(data), "--image-size", "0", *drift]) == 0
    lerobot(
        lerobot_train,
        policy__type="forward",
        policy__push_to_hub=False,
        dataset__repo_id="local/data",
        dataset__root=data,
        steps=2,
        batch_size=2,
        num_workers=0,
        env_eval_freq=0,
        output_dir=folder / "trained",
    )
    evaluate = ["evaluate", "--policy", str(policy), "--out", str(folder / "results"), *drift]
    assert dynahoi(evaluate) == BAD_INPUT, "a policy that is not on the list needs --trust"
    assert dynahoi([*evaluate, "--trust"]) == 0
    lerobot(
        lerobot_eval,
        policy__path=policy,
        env__type="dynahoi",
        env__task="a_drift",
        env__image_size=32,
        env__results_dir=folder / "in_lerobot",
        output_dir=folder / "evaluated",
        eval__batch_size=2,
        eval__n_episodes=2,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
