"""Play the motion of a third party by its name with ``lerobot-eval``.

python -m tests.third_party.in_lerobot POLICY FOLDER
"""

import sys
from pathlib import Path

from lerobot.scripts.lerobot_eval import main as lerobot_eval
from lerobot_env_dynahoi.configuration_dynahoi import DynahoiEnvConfig

import tests.third_party.things  # noqa: F401 - registers the motion


def main(policy: str, folder: Path) -> None:
    assert "a_drift" not in DynahoiEnvConfig(task="straight_line").recipe().motion_names
    both = DynahoiEnvConfig(task="a_drift,lob", image_size=32)
    assert both.recipe().motions == ("lob", "a_drift")
    options = {
        "policy.path": policy,
        "env.type": "dynahoi",
        "env.task": "a_drift",
        "env.image_size": 32,
        "env.results_dir": folder / "a_drift",
        "output_dir": folder / "lerobot",
        "eval.batch_size": 2,
        "eval.n_episodes": 2,
    }
    sys.argv = ["lerobot-eval", *(f"--{name}={value}" for name, value in options.items())]
    lerobot_eval()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
