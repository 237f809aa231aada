"""Convert an OpenVLA checkpoint into a LeRobot policy, to evaluate or fine-tune it.

    python -m lerobot_policy_actiontokens.import_openvla CHECKPOINT --unnorm-key DATASET --out
    FOLDER

The weights are copied; the checkpoint is still needed for its configuration and tokenizer.
"""

import argparse
import sys
from pathlib import Path

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION

from .configuration_actiontokens import ActionTokensConfig
from .modeling_actiontokens import ActionTokensPolicy
from .processor_actiontokens import action_stats, make_actiontokens_pre_post_processors


def import_openvla(
    checkpoint: str, unnorm_key: str, out: Path, *, camera: str, image_size: int, dtype: str
) -> None:
    """Write the policy and its pre- and postprocessor to a folder.

    Args:
        checkpoint: folder or Hub name.
        unnorm_key: dataset in its ``norm_stats``, which also determines the size of an action.
        out: folder to write.
        camera: key of the images.
        image_size: side of the images [px].
        dtype: data type of the weights, "float32" or "bfloat16".

    Raises:
        ValueError: if the checkpoint has no statistics of that dataset.
    """
    size = len(action_stats(checkpoint, unnorm_key)["q01"])
    config = ActionTokensConfig(
        vlm_name=checkpoint,
        unnorm_key=unnorm_key,
        dtype=dtype,
        device="cuda" if torch.cuda.is_available() else "cpu",
        push_to_hub=False,
        input_features={camera: PolicyFeature(FeatureType.VISUAL, (3, image_size, image_size))},
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (size,))},
    )
    ActionTokensPolicy(config).save_pretrained(out)
    for pipeline in make_actiontokens_pre_post_processors(config):
        pipeline.save_pretrained(out)


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", help="folder or Hub name, e.g. openvla/openvla-7b")
    parser.add_argument(
        "--unnorm-key", required=True, help="dataset in the checkpoint's norm_stats"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--camera", default="observation.images.ego", help="key of the images")
    parser.add_argument("--image-size", type=int, default=224, help="side of the images [px]")
    parser.add_argument(
        "--dtype", default="bfloat16", help="data type of the weights: float32 or bfloat16"
    )
    try:
        import_openvla(**vars(parser.parse_args()))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
