"""vla-eval's LeRobot server with ObAct: ``python obact_server.py --args.checkpoint FOLDER``.

That server imports no plugins. It refuses policies that look back, because it does not show them
the observations between two chunks; ObAct executes one action of a chunk and so sees every one.
"""

from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot_policy_obact import ObActPolicy
from vla_eval.model_servers.lerobot import LeRobotModelServer
from vla_eval.model_servers.serve import run_server


class ObActModelServer(LeRobotModelServer):
    """Answers each observation with a chunk, of which one action is executed.

    Args:
        checkpoint: folder or Hub repository.
        device: torch device.
        options: of vla-eval's server.
    """

    def __init__(self, checkpoint: str, device: str = "cpu", **options: Any) -> None:
        looks_back = PreTrainedConfig.from_pretrained(checkpoint).n_obs_steps
        hidden = {"n_obs_steps": 1, "n_action_steps": 1}
        super().__init__(
            ObActPolicy.name, checkpoint, device=device, policy_kwargs=hidden, **options
        )
        self._policy.config.n_obs_steps = looks_back
        self._policy.reset()


if __name__ == "__main__":
    run_server(ObActModelServer)
