"""Make a checkpoint of a training that only acts: with the averaged weights alone, as
`checkpoints/` has them.

python -m lerobot_policy_obact.export outputs/obact/checkpoints/last/pretrained_model my_policy
"""

import argparse
from pathlib import Path

from lerobot.policies.factory import make_pre_post_processors

from . import ObActPolicy


def export(checkpoint: Path, out: Path) -> None:
    """Write the policy of a checkpoint, its processors and the config of its training, from which
    it no longer resumes.

    Its ``ema_decay`` is 0, since there is nothing left to average.
    """
    policy = ObActPolicy.from_pretrained(checkpoint).to("cpu")
    # where every machine can load it, which that of the training need not be
    policy.config.device = "cpu"
    policy.keep_average()
    policy.config.pretrained_path = None  # a place on this machine
    policy.save_pretrained(out)
    on_cpu = {"device_processor": {"device": "cpu"}}
    for processor in make_pre_post_processors(
        policy.config, str(checkpoint), preprocessor_overrides=on_cpu
    ):
        processor.save_pretrained(out)
    training = checkpoint / "train_config.json"
    if training.is_file():
        (out / training.name).write_bytes(training.read_bytes())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path, help="pretrained_model folder of a training")
    parser.add_argument("out", type=Path, help="folder to write")
    export(**vars(parser.parse_args()))
