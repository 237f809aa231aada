"""LeRobot's asynchronous policy server, with ObAct among the policies it knows.

LeRobot's server loads no plugins and accepts a fixed list of policies. Importing this module
registers the plugin and adds it to that list; run as a program it also starts the server, with
LeRobot's arguments:

    python -m lerobot_policy_obact.launch_policy_server --host=127.0.0.1 --port=8080 --fps=20
"""

from collections.abc import Callable
from typing import cast

from lerobot.async_inference import policy_server
from lerobot.async_inference.constants import SUPPORTED_POLICIES

from . import ObActPolicy

SUPPORTED_POLICIES.append(ObActPolicy.name)


def main() -> None:
    """Serve robots, which move on while the policy computes."""
    ObActPolicy.real_time = True
    serve = cast(Callable[[], None], policy_server.serve)  # parses the command line
    serve()


if __name__ == "__main__":
    main()
