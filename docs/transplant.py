"""Draw a window of ObAct's training before and after a transplant: ``python docs/transplant.py``.

``images/transplant.png`` shows a recorded hand and a virtual one that watch the same target: from
above, where each goes and where it sees the target; and in the image of each, where the target is
and where the eye sees it.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot_policy_obact import ObActConfig, ObActPolicy
from lerobot_policy_obact.windows import VirtualHands, Window
from matplotlib.axes import Axes
from torch.utils.data import default_collate

from dynahoi_lerobot.cli.main import main as dynahoi
from dynahoi_lerobot.encode import encode

IMAGE = Path(__file__).parent / "images/transplant.png"
CHECKPOINT = Path("checkpoints/obact_standard")
RECORDING = ["--recipe", "recipes/generate/train.yaml", "--episodes", "4", "--seed", "3"]
EPISODE = 2
CURRENT = 12  # frame of that episode in which a decision is taken
HANDS = 8  # virtual hands that are drawn at random
SHOWN = 3  # of which this is shown
RECORDED, VIRTUAL, TARGET = "tab:blue", "tab:orange", "0.6"


def windows(root: Path) -> tuple[ObActPolicy, Window, Window]:
    """Return the policy, a recorded window and the same one with virtual hands."""
    config = ObActConfig.from_pretrained(CHECKPOINT)
    config.pretrained_path = CHECKPOINT
    config.n_obs_steps = 13
    config.n_future_steps = 24
    meta = LeRobotDatasetMetadata("local/shown", root=root)
    policy = ObActPolicy.from_pretrained(CHECKPOINT, config=config, dataset_meta=meta)
    times = resolve_delta_timestamps(config, meta)
    dataset = LeRobotDataset("local/shown", root=root, delta_timestamps=times)
    known = policy.targets
    assert known is not None
    batch = default_collate([dataset[int(known.first_index[EPISODE]) + CURRENT]])
    window = Window.of(batch, policy.model, known)
    torch.manual_seed(0)
    virtual = VirtualHands(known.teacher, policy.model).drawn(window.repeated(HANDS), 1.0)
    return policy, window, virtual


def until_catch(window: Window, hand: int) -> int:
    """Return how many frames are shown: those before the catch, where decisions are taken."""
    assert window.targets is not None
    return int(window.targets.catch[hand].clamp_max(window.recorded.shape[1]))


def draw_from_above(axes: Axes, policy: ObActPolicy, window: Window, hand: int, color: str) -> None:
    """Draw the way of a palm, and where it sees the target [m]."""
    centers, rays = policy.model.forecaster.sighted(window.frames)
    last = until_catch(window, hand)
    palm = window.frames.palm[hand, :last]
    seen = (centers + rays)[hand, :last, 0]
    axes.plot(palm[:, 0], palm[:, 1], color=color, lw=2)
    axes.plot(*palm[-1, :2], color=color, marker="o")
    axes.scatter(seen[:, 0], seen[:, 1], color=color, s=9)


def draw_in_image(axes: Axes, policy: ObActPolicy, window: Window, hand: int, color: str) -> None:
    """Draw where the target is in the images of a hand, and where the eye sees it."""
    camera = policy.model.forecaster.cameras[0]
    assert window.targets is not None
    last = until_catch(window, hand)
    true = camera.project(window.targets.path[hand, :last] - window.frames.palm[hand, :last])
    seen = window.frames.sightings[hand, :last, 0]
    axes.plot(true[:, 0], true[:, 1], color=TARGET, lw=1)
    axes.scatter(seen[:, 0], seen[:, 1], color=color, s=9)
    for before, after in zip(true, seen, strict=True):
        axes.plot([before[0], after[0]], [before[1], after[1]], color=color, lw=0.5)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), aspect="equal", xticks=[], yticks=[])


@torch.no_grad()
def main() -> None:
    """Record, encode and draw."""
    with TemporaryDirectory() as folder:
        images, root = Path(folder) / "images", Path(folder) / "encoded"
        dynahoi(["generate", *RECORDING, "--root", str(images)])
        encode(images, root)
        policy, recorded, virtual = windows(root)
    assert virtual.targets is not None
    figure, (above, left, right) = plt.subplots(1, 3, figsize=(10, 3.8), layout="constrained")
    path = virtual.targets.path[SHOWN, : virtual.recorded.shape[1]]
    above.plot(path[:, 0], path[:, 1], color=TARGET, lw=3)
    draw_from_above(above, policy, recorded, 0, RECORDED)
    draw_from_above(above, policy, virtual, SHOWN, VIRTUAL)
    above.set(title="from above", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    draw_in_image(left, policy, recorded, 0, RECORDED)
    left.set_title("image of the recorded hand", color=RECORDED)
    draw_in_image(right, policy, virtual, SHOWN, VIRTUAL)
    right.set_title("image of the virtual hand", color=VIRTUAL)
    figure.savefig(IMAGE, dpi=110)


if __name__ == "__main__":
    main()
