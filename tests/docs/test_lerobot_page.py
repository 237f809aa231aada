"""docs/lerobot.md: every option of LeRobot's has a row."""

import re
from dataclasses import fields
from pathlib import Path

from lerobot.configs import PreTrainedConfig
from lerobot.configs.default import DatasetConfig, EvalConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.envs.configs import EnvConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/lerobot.md").read_text()
CONFIGS = {
    "": (TrainPipelineConfig, EvalPipelineConfig),
    "dataset.": (DatasetConfig,),
    "policy.": (PreTrainedConfig,),
    "env.": (EnvConfig,),
    "eval.": (EvalConfig,),
    "robot.": (RobotConfig,),
    "teleop.": (TeleoperatorConfig,),
}
"""LeRobot's configs by the group of options that each is."""


def test_every_option_has_a_row() -> None:
    section = re.split(r"\n#+ ", TEXT.split("## Options\n")[1])[0]
    rows = re.findall(r"^\| (`.+?) \|", section, re.MULTILINE)
    told = [option for row in rows for option in re.findall(r"`(.+?)`", row)]
    assert len(told) == len({*told})
    options = {
        prefix + field.name
        for prefix, configs in CONFIGS.items()
        for config in configs
        for field in fields(config)
        if field.init
    }
    groups = {prefix.rstrip(".") for prefix in CONFIGS}
    every_policy_has = {"policy.normalization_mapping"}
    assert {*told} == (options | every_policy_has) - groups
