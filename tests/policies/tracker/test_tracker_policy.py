"""The policy around the network: averaging, checkpoints, compilation, processes, augmentation, the server."""

from __future__ import annotations

import pickle
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import torch.distributed as dist
from lerobot.async_inference.configs import PolicyServerConfig
from lerobot.async_inference.helpers import RemotePolicyConfig, TimedAction, TimedObservation
from lerobot.async_inference.policy_server import PolicyServer
from lerobot.policies import make_pre_post_processors
from lerobot_policy_tracker import TrackerPolicy
from lerobot_policy_tracker.augment import jitter_colors, shift_images
from lerobot_policy_tracker.launch_policy_server import allow_tracker
from lerobot_policy_tracker.text import ByteTextEncoder, encode_bytes
from tracker_helpers import PUSH_FEATURES, SIZE, make_batch, make_policy, randomise

CHECKPOINTS = Path(__file__).parents[3] / "checkpoints"


def train_steps(policy: TrackerPolicy, n: int, lr: float = 1e-2) -> None:
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=lr)
    for seed in range(n):
        policy.train()
        policy(make_batch(policy, seed=seed))[0].backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()


def distance(a: torch.nn.Module, b: torch.nn.Module) -> float:
    return sum((x - y).abs().sum().item() for x, y in zip(a.parameters(), b.parameters(), strict=True))


# -- averaged weights ----------------------------------------------------------------------------------------------


def test_acting_uses_the_average_and_training_does_not() -> None:
    policy = make_policy(ema_decay=0.9)
    start = make_policy(ema_decay=0.9)
    train_steps(policy, 6)
    assert 0 < distance(policy.ema.module, start.model) < distance(policy.model, start.model)
    batch = make_batch(policy)
    averaged = policy.predict_action_chunk(batch)
    policy.model.load_state_dict(policy.ema.module.state_dict())
    torch.testing.assert_close(policy.predict_action_chunk(batch), averaged)
    policy.ema = None
    torch.testing.assert_close(policy.predict_action_chunk(batch), averaged)


def test_the_average_follows_its_definition() -> None:
    policy = make_policy(ema_decay=0.5)
    weight = policy.model.camera
    expected = None
    for n, value in enumerate((1.0, 4.0, -2.0, 0.5)):
        weight.data.fill_(value)
        policy.update()
        decay = min(0.5, (1 + n) / (10 + n))
        expected = value if expected is None else decay * expected + (1 - decay) * value
    torch.testing.assert_close(policy.ema.module.camera, torch.full_like(weight, expected))


@pytest.mark.parametrize(("saved", "opened"), [(0.9, 0.0), (0.0, 0.9), (0.9, 0.9), (0.0, 0.0)])
def test_checkpoints_with_and_without_average_act_the_same(saved: float, opened: float, tmp_path: Path) -> None:
    policy = make_policy(ema_decay=saved)
    train_steps(policy, 3)
    batch = make_batch(policy)
    chunk = policy.predict_action_chunk(batch)
    policy.config.ema_decay = opened
    policy.save_pretrained(tmp_path)
    again = TrackerPolicy.from_pretrained(tmp_path)
    assert (again.ema is None) == (opened == 0)
    torch.testing.assert_close(again.predict_action_chunk(batch), chunk, rtol=0, atol=0)


def test_averaged_weights_are_not_optimised() -> None:
    policy = make_policy(ema_decay=0.9)
    groups = policy.get_optim_params()
    assert sum(len(group["params"]) for group in groups) == len(list(policy.model.parameters()))
    assert not any(p.requires_grad for p in policy.ema.parameters())
    assert all(p.dim() >= 2 for p in groups[0]["params"])
    assert groups[1]["weight_decay"] == 0


# -- precision, compilation, processes -----------------------------------------------------------------------------


def test_half_precision_gives_nearly_the_same_loss() -> None:
    policy = randomise(make_policy()).eval()
    batch = make_batch(policy)
    losses = []
    for enabled in (False, True):
        torch.manual_seed(0)
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            losses.append(policy(batch)[0])
    assert losses[1].dtype == torch.float32
    assert losses[0] != losses[1]
    torch.testing.assert_close(losses[0], losses[1], rtol=0.05, atol=0.05)


def test_a_compiled_policy_gives_the_same_chunks_and_checkpoint_names() -> None:
    plain, compiled = make_policy(), make_policy(compile_model=True, compile_backend="eager")
    batch = make_batch(plain)
    torch.testing.assert_close(compiled.predict_action_chunk(batch), plain.predict_action_chunk(batch))
    assert compiled.state_dict().keys() == plain.state_dict().keys()


def test_gradients_flow_through_distributed_training(tmp_path: Path) -> None:
    policy, reference = make_policy(), make_policy()
    dist.init_process_group("gloo", init_method=f"file://{tmp_path}/group", rank=0, world_size=1)
    try:
        wrapped = torch.nn.parallel.DistributedDataParallel(policy, find_unused_parameters=True)
        for module in (wrapped, reference):
            torch.manual_seed(0)
            module.train()(make_batch(policy))[0].backward()
    finally:
        dist.destroy_process_group()
    for (name, a), b in zip(policy.model.named_parameters(), reference.model.parameters(), strict=True):
        torch.testing.assert_close(a.grad, b.grad, msg=name)


# -- augmentation and text -----------------------------------------------------------------------------------------


def test_all_frames_of_a_sample_shift_together() -> None:
    torch.manual_seed(0)
    images = torch.zeros(8, 3, 3, 16, 16)
    images[..., 8, 8] = 1
    shifted = shift_images(images, 3)
    places = shifted[:, :, 0].flatten(2).argmax(-1)  # (B, T)
    assert (places == places[:, :1]).all()
    assert len(places[:, 0].unique()) > 3
    assert (torch.stack([places // 16, places % 16]) - 8).abs().max() <= 3


def test_color_jitter_keeps_range_and_order_of_frames() -> None:
    torch.manual_seed(0)
    images = torch.rand(4, 2, 3, 8, 8)
    images[:, 1] = images[:, 0]
    changed = jitter_colors(images, 0.5)
    assert (changed[:, 0] == changed[:, 1]).all()
    assert changed.min() >= 0
    assert changed.max() <= 1
    assert (changed - images).abs().amax(dim=(1, 2, 3, 4)).min() > 0.01


def test_augmentation_is_for_training_only() -> None:
    policy = randomise(make_policy(random_shift_px=4, color_jitter=0.5))
    plain = make_policy()
    plain.load_state_dict(policy.state_dict())
    batch = make_batch(policy)
    for training in (False, True):
        losses = []
        for p in (policy, plain):
            torch.manual_seed(0)
            losses.append(p.train(training)(batch)[0].item())
        assert (losses[0] == losses[1]) == (not training)


def test_text_padding_does_not_change_a_token() -> None:
    torch.manual_seed(0)
    encoder = ByteTextEncoder(16)
    alone = encoder(["catch"])
    together = encoder(["catch", "catch the ball that is swinging", ""])
    torch.testing.assert_close(together[:1], alone)
    assert (together[1] - together[0]).abs().max() > 1e-3
    assert together.isfinite().all()


def test_bytes_are_shifted_and_cut() -> None:
    assert encode_bytes(["a", "é"], 8).tolist() == [[98, 0], [196, 170]]
    assert encode_bytes(["abc"], 2).tolist() == [[98, 99]]


# -- the asynchronous server ---------------------------------------------------------------------------------------


def served(checkpoint: Path, camera: str, n_joints: int, size: int) -> list[TimedAction]:
    """Return what LeRobot's server answers to the picture of a camera, ``size`` px, and joints, at time step 7."""
    allow_tracker()
    joints = [f"joint_{i}" for i in range(n_joints)]
    features = {
        "observation.state": {"dtype": "float32", "shape": (n_joints,), "names": joints},
        f"observation.images.{camera}": {"dtype": "image", "shape": (size, size, 3), "names": ["h", "w", "c"]},
    }
    specs = RemotePolicyConfig("tracker", str(checkpoint), features, actions_per_chunk=5, device="cpu")
    server, client = PolicyServer(PolicyServerConfig()), SimpleNamespace(peer=lambda: "test")
    server.Ready(None, client)
    server.SendPolicyInstructions(SimpleNamespace(data=pickle.dumps(specs)), client)
    image = torch.zeros(size, size, 3, dtype=torch.uint8).numpy()
    observation = {**dict.fromkeys(joints, 0.1), camera: image, "task": "push"}
    return server._predict_action_chunk(TimedObservation(timestamp=1.0, timestep=7, observation=observation))


def test_the_policy_server_serves_tracker(tmp_path: Path) -> None:
    policy = make_policy({key.replace("image", "images.top"): value for key, value in PUSH_FEATURES.items()})
    policy.save_pretrained(tmp_path)
    for processor in make_pre_post_processors(policy.config):
        processor.save_pretrained(tmp_path)
    actions = served(tmp_path, "top", 2, SIZE)
    assert [action.get_timestep() for action in actions] == [7, 8, 9, 10, 11]
    assert all(action.get_action().shape == (2,) for action in actions)


def test_the_policy_server_serves_a_checkpoint_that_learned_with_the_phase_of_an_episode() -> None:
    """The server's clients send pictures and joints, not whether the hand may move."""
    actions = served(CHECKPOINTS / "tracker_standard", "ego", 18, 96)
    assert [action.get_timestep() for action in actions] == [7, 8, 9, 10, 11]
    assert all(action.get_action().isfinite().all() for action in actions)


@pytest.mark.parametrize("mode", ["IDENTITY", "MEAN_STD"])
def test_without_its_phase_the_hand_may_move(mode: str) -> None:
    """Normalised to mean 0, its mean is taken."""
    policy = make_policy(normalization_mapping={"VISUAL": "IDENTITY", "STATE": mode, "ACTION": "IDENTITY"}).eval()
    batch = make_batch(policy)
    told = torch.eye(2)[1] if mode == "IDENTITY" else torch.zeros(2)
    batch["observation.phase"] = told.expand_as(batch["observation.phase"])
    expected = policy.predict_action_chunk(batch)
    policy.reset()
    del batch["observation.phase"]
    torch.testing.assert_close(policy.predict_action_chunk(batch), expected)
