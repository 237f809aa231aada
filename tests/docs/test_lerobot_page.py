"""docs/lerobot.md: every "yes" names the tests that cover it, and every option of LeRobot's has a
row.
"""

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.configs.default import DatasetConfig, EvalConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.envs.configs import EnvConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/lerobot.md").read_text()
BLOCKS = "docs/test_blocks_run.py::test_every_program_and_command_runs"
"""Plays the commands of all pages."""
ROBOT = "env/test_robot_in_lerobot.py::"
COVERED = {
    "`LeRobotDataset`, `delta_timestamps`, `episode_filter`": (
        "dataset/test_in_lerobot.py::test_opens_and_its_episode_columns_can_be_filtered_and_read",
        "dataset/test_in_lerobot.py::test_windows_over_time_stay_within_the_episode",
    ),
    '`LeRobotDataset("USER/NAME")`': (
        "hub/test_push.py::test_whoever_fetches_a_dataset_with_lerobot_gets_the_privileged_tables",
    ),
    "language columns": (
        "dataset/test_in_lerobot.py::test_lerobot_finds_the_subtask_of_every_frame",
    ),
    "`lerobot-edit-dataset`": (
        "verify/test_edited_by_lerobot.py::"
        "test_every_operation_of_lerobots_command_leaves_datasets_that_open",
        BLOCKS,
    ),
    "other readers of the format": (
        "dataset/test_in_lerobot.py::"
        "test_a_reader_that_takes_names_of_statistics_apart_gets_those_of_the_dataset",
        "dataset/test_in_lerobot.py::test_datasets_loads_the_frames_and_nothing_else_by_the_card",
    ),
    "`lerobot-train`, resumed, fine-tuned": (
        "policies/obact/test_obact_policy.py::test_training_goes_on_and_begins_from_a_checkpoint",
        BLOCKS,
    ),
    "`lerobot-train --peft.method_type=LORA`": (
        "evaluate/test_adapter.py::test_lerobot_trains_an_adapter_that_plays_here",
        "evaluate/test_adapter.py::"
        "test_an_adapter_plays_in_every_command_and_results_name_both_weights",
    ),
    "`--rename_map`": (
        "evaluate/test_adapter.py::test_lerobot_trains_with_renamed_cameras_what_plays_here",
        "evaluate/test_adapter.py::test_a_checkpoint_with_renamed_cameras_plays_in_every_command",
        "evaluate/test_adapter.py::test_lerobot_eval_plays_it_with_and_without_the_map",
    ),
    "LeRobot's other policies": ("zoo/test_zoo.py::test_two_steps_and_an_episode",),
    "`lerobot-eval --env.type=dynahoi`": (
        "env/test_lerobot_plugin.py::test_lerobots_loop_fills_the_result_folder",
        "env/test_lerobot_plugin.py::test_lerobots_loop_and_ours_give_the_same_rows",
    ),
    "`lerobot-teleoperate`, `-record`, `-replay`, `-rollout`, `robot_client`": (
        f"{ROBOT}test_the_expert_teleoperates",
        f"{ROBOT}test_recordings_merge_with_generated_datasets_and_can_be_trained_on",
        f"{ROBOT}test_a_generated_episode_is_replayed_and_caught",
        f"{ROBOT}test_a_policy_is_rolled_out_episode_by_episode",
        f"{ROBOT}test_a_policy_server_moves_it",
    ),
    '`make_env("USER/NAME", trust_remote_code=True)`': (
        "hub/test_push.py::test_lerobot_makes_the_environment_that_was_pushed",
    ),
}
"""Row of the page that says yes: its tests, below tests/."""
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


def rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading, without its first two lines."""
    section = TEXT.split(heading, 1)[1]
    lines = [line for line in re.split(r"\n#+ ", section)[0].split("\n") if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[1:]]


def test_every_yes_has_tests_and_nothing_else_is_said_to_have() -> None:
    said = [name for name, works, _ in rows("# LeRobot notes\n") if works == "yes"]
    assert sorted(said) == sorted(COVERED)


@pytest.mark.parametrize("test", sorted({test for tests in COVERED.values() for test in tests}))
def test_the_tests_are_there(test: str) -> None:
    path, name = test.split("::")
    tree = ast.parse((ROOT / "tests" / path).read_text())
    assert name in [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]


def test_every_option_has_a_row() -> None:
    told = [option for cells in rows("## Options\n") for option in re.findall(r"`(.+?)`", cells[0])]
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
