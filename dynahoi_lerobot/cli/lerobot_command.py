"""``python -m dynahoi_lerobot.cli.lerobot_command NAME ...``: the command ``lerobot-NAME``, without
the 100 lines about torchcodec.
"""

import importlib
import sys

from dynahoi_lerobot.core.lerobot_internals import video_backend_unspoken


def main() -> None:
    """Run the command that the first word names, with the remaining words as its arguments."""
    name = sys.argv[1]
    sys.argv[:2] = [f"lerobot-{name}"]
    with video_backend_unspoken():
        importlib.import_module(f"lerobot.scripts.lerobot_{name}").main()


if __name__ == "__main__":
    main()
