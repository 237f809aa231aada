"""What LeRobot's command line says of the policy: LeRobot makes an env first and does not pass the
policy to it.
"""

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import draccus
import yaml
from lerobot.configs import PreTrainedConfig

from dynahoi_lerobot.core.lerobot_internals import command_name, given, given_policy, given_type
from dynahoi_lerobot.core.reading import ReadError, read_object, read_yaml
from dynahoi_lerobot.evaluate.checkpoint_files import CONFIG, described_folder, folder_weights
from dynahoi_lerobot.evaluate.checkpoint_rules import renamed, trained_for
from dynahoi_lerobot.rollout.inference import Inference, StepwiseInference


@dataclass(frozen=True)
class Launch:
    """How LeRobot was started.

    Attributes:
        policy: what is being played: the policy's type, its path, or just ``policy``.
        rules: values of fields of `Rules` that its checkpoint was trained for, see ``trained_for``.
        weights: sha256 of the weights of the local checkpoint that ``lerobot-eval`` plays; nothing
            elsewhere: in training the checkpoint is what training began with.
        renames: the rename map that the checkpoint was trained with, if the command line gives
            none: LeRobot then leaves out what the checkpoint renames.
        config: of the policy; None if the command line names no policy, or nobody asks.
        output_dir: LeRobot's.
    """

    policy: str = "policy"
    rules: dict[str, Any] = field(default_factory=dict)
    weights: dict[str, str] = field(default_factory=dict)
    renames: dict[str, str] = field(default_factory=dict)
    config: Any = None
    output_dir: Path = Path("outputs")

    def results_folder(self, named: str | None) -> Path:
        """Return the folder for an evaluation that begins now: the one that ``env.results_dir``
        names, or else a new one below LeRobot's. A training evaluates several times, so each of its
        evaluations has a new folder below the named one.
        """
        if named is not None and command_name() != "lerobot-train":
            return Path(named)
        parent = self.output_dir / "dynahoi" if named is None else Path(named)
        return parent / datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")

    def stepwise(self, timing: Inference, n_action_steps: int) -> StepwiseInference:
        """Return the timeline of one environment whose policy is asked for one action a call.

        Args:
            timing: of the policy's inference.
            n_action_steps: how many calls an inference answers, where no command line names the
                policy; 0 if not told.

        Raises:
            ValueError: if neither says how many, if the two differ, or if the timing cannot be had
                with the policy.
        """
        name = getattr(self.config, "type", "policy")
        steps = getattr(self.config, "n_action_steps", 0) or n_action_steps
        if n_action_steps not in (0, steps):
            raise ValueError(
                f"env.n_action_steps is {n_action_steps}, but the policy's is {steps}; leave it out"
            )
        if steps < 1:
            raise ValueError(
                f"inference async must know how many actions of a chunk {name!r} executes, and is "
                f"not told; pass --env.n_action_steps, or use dynahoi evaluate --inference async"
            )
        frames = getattr(self.config, "observation_delta_indices", None) or [0]
        if getattr(self.config, "sees_frames_once", False):
            frames = [0]  # it does not mind that the world stands still while its queue is read
        return StepwiseInference(timing, name, steps, lookback_frames=-min(frames))


def read_launch(*, policy_config: bool = False) -> Launch:
    """Read the command line of this process and the config file that it names; nothing else here
    does. The policy's config is read on request.
    """
    path = _checkpoint()
    rules: dict[str, Any] = {}
    weights: dict[str, str] = {}
    renames: dict[str, str] = {}
    name = path or given_type("policy") or "policy"
    if path:
        try:
            folder = described_folder(path, given("policy.pretrained_revision"))
            told = _rename_map()
            renames = {} if told else renamed(folder)
            rules = trained_for(folder, told or renames)
            name = path if folder != Path(path) else str(read_object(folder / CONFIG).get("type"))
        except ReadError:
            pass  # LeRobot says what is wrong with it
    if path and command_name() == "lerobot-eval":
        weights = folder_weights(Path(path))
    config = _policy_config() if policy_config else None
    return Launch(name, rules, weights, renames, config, _output_dir())


def _checkpoint() -> str | None:
    """Return the path of the checkpoint that is played, or from which a training began. The command
    line names it, or the config file does, as that of a training that is resumed.
    """
    path, _ = given_policy()
    policy = _option("policy")
    told = policy.get("pretrained_path") if isinstance(policy, dict) else None
    return path or given("policy.pretrained_path") or told


def _output_dir() -> Path:
    """LeRobot's ``--output_dir``."""
    return Path(_option("output_dir") or "outputs")


def _rename_map() -> dict[str, str]:
    """LeRobot's ``--rename_map``, as far as it is one."""
    told = _option("rename_map")
    names = yaml.safe_load(told) if isinstance(told, str) else told
    return names if isinstance(names, dict) else {}


def _option(name: str) -> Any:
    """The value of an option of LeRobot's, which the file of ``--config_path`` may give, too; None
    if neither does.
    """
    config = Path(given("config_path") or "")
    told = read_yaml(config) if config.is_file() else {}
    return given(name) or told.get(name)


def _policy_config() -> Any | None:
    """The config that LeRobot reads from the command line, None if that names no policy."""
    path, overrides = given_policy()
    if path is not None:
        return PreTrainedConfig.from_pretrained(path, cli_overrides=overrides)
    kind = given_type("policy")
    if kind is not None:
        return draccus.parse(PreTrainedConfig.get_choice_class(kind), args=overrides)
    return None
