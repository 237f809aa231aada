"""LeRobot's asynchronous policy server, with ObAct among the policies it knows.

LeRobot's server loads no plugins and accepts a fixed list of policies. This launcher registers the plugin, adds it to
that list and starts the server; all arguments are LeRobot's:

    python -m lerobot_policy_obact.launch_policy_server --host=127.0.0.1 --port=8080 --fps=20
"""

from collections.abc import Callable
from typing import cast

from lerobot.async_inference import policy_server
from lerobot.async_inference.constants import SUPPORTED_POLICIES

from . import ObActPolicy


def allow_obact() -> None:
    """Add ObAct to the server's list, once."""
    if ObActPolicy.name not in SUPPORTED_POLICIES:
        SUPPORTED_POLICIES.append(ObActPolicy.name)


def main() -> None:
    """Start the server with LeRobot's command-line arguments."""
    allow_obact()
    cast(Callable[[], None], policy_server.serve)()  # its argument is parsed from the command line


if __name__ == "__main__":
    main()
