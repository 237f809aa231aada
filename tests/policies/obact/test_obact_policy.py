"""The policy through LeRobot's own commands: any dataset, recorded episodes, checkpoints, history,
servers.
"""

import json
import pickle
import sys
from copy import deepcopy
from itertools import chain, repeat
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from accelerate.state import AcceleratorState
from lerobot.async_inference.configs import PolicyServerConfig
from lerobot.async_inference.constants import SUPPORTED_POLICIES
from lerobot.async_inference.helpers import RemotePolicyConfig, TimedObservation
from lerobot.async_inference.policy_server import PolicyServer
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_pre_post_processors
from lerobot.policies.rtc import RTCConfig
from lerobot.rollout.inference.rtc import supports_rtc_inference
from lerobot.scripts.lerobot_train import main
from lerobot_policy_obact import ObActConfig, ObActPolicy, launch_policy_server, recordings
from lerobot_policy_obact.configuration_obact import Rig
from lerobot_policy_obact.decisions import Episodes, closed_loop_loss, decision_losses, rolled_rows
from lerobot_policy_obact.encoders import SHIPPED
from lerobot_policy_obact.export import export
from lerobot_policy_obact.network import ObActModel
from lerobot_policy_obact.teacher import NEVER, Grip, Targets, Teacher
from lerobot_policy_obact.virtual_episodes import SightingErrors
from safetensors.torch import load_file
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.nn.attention import SDPBackend, sdpa_kernel

from tests.checkpoints import FEATURES, SMALL_GR00T
from tests.checkpoints import SHIPPED as SHIPPED_POLICY
from tests.tools import generated, python

N_EPISODES, N_FRAMES, FPS, SIZE = 2, 30, 10, 48
TINY = {
    "dim": 16,
    "n_heads": 2,
    "width": 32,
    "n_points": 4,
    "horizon": 4,
    "n_action_steps": 2,
    "n_obs_frames": 3,
}
TINY |= {
    "device": "cpu",
    "push_to_hub": False,
    "head_options": {"width": 16},
    "encoder_options": {"channels": 8},
}
TINY |= {"encoder": "conv", "freeze_encoder": False, "relative_dims": 2}
HAND = {name: FEATURES[name] for name in ("input_features", "output_features")}
LABELLED = {"episode_index": torch.arange(4), "action": torch.zeros(4, 4, 18)}
"""A batch that names every episode of ``hand_root``."""


@pytest.fixture(autouse=True)
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Encoded images are cached in a folder of the test, and no more virtual episodes are played
    than are asked for.
    """
    monkeypatch.setattr("lerobot_policy_obact.recordings.HF_LEROBOT_HOME", tmp_path)
    monkeypatch.setattr("lerobot_policy_obact.virtual_episodes.POOL", 1)


def lerobot_train(
    monkeypatch: pytest.MonkeyPatch, root: Path, out: Path, **options: object
) -> Path:
    """Train for two steps, and return the checkpoint."""
    AcceleratorState._reset_state(
        reset_partial_state=True
    )  # each command is a process of its own otherwise
    options = {
        "policy.type": "obact",
        **{f"policy.{key}": value for key, value in (TINY | options).items()},
    }
    options |= {
        "dataset.repo_id": "local/tiny",
        "dataset.root": root,
        "output_dir": out,
        "seed": 1,
        "steps": 2,
    }
    options |= {"batch_size": 2, "save_freq": 2, "num_workers": 0, "log_freq": 1}
    words = [
        f"--{k}={v if isinstance(v, str | Path) else json.dumps(v)}" for k, v in options.items()
    ]
    monkeypatch.setattr(sys, "argv", ["lerobot-train", *words])
    main()
    return out / "checkpoints/last/pretrained_model"


@pytest.fixture(scope="module")
def push_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset like PushT's: one camera, two coordinates, no hand and no target."""
    root = tmp_path_factory.mktemp("push") / "data"
    image = {"dtype": "image", "shape": (SIZE, SIZE, 3), "names": ["height", "width", "channel"]}
    vector = {"dtype": "float32", "shape": (2,), "names": None}
    features = {"observation.image": image, "observation.state": vector, "action": vector}
    dataset = LeRobotDataset.create(
        "local/tiny", fps=FPS, features=features, root=root, use_videos=False
    )
    rng = np.random.default_rng(0)
    for _ in range(N_EPISODES):
        walk = rng.normal(size=(N_FRAMES + 1, 2)).cumsum(0).astype(np.float32)
        for t in range(N_FRAMES):
            picture = rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
            dataset.add_frame(
                {
                    "observation.image": picture,
                    "observation.state": walk[t],
                    "action": walk[t + 1],
                    "task": "push",
                }
            )
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture(scope="module")
def hand_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recorded episodes of DynaHOI."""
    return generated(tmp_path_factory.mktemp("hand") / "data", "--image-size", "32", episodes=4)


@pytest.fixture(scope="module")
def contact_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recorded episodes of the contact track."""
    return generated(
        tmp_path_factory.mktemp("contact") / "data", "--capture", "contact", "--image-size", "32"
    )


RECORDED = {
    "encoder": "eye",
    "encoder_options": {"channels": 8, "fovea": 12},
    "freeze_encoder": True,
    "relative_dims": 3,
    "n_obs_frames": None,
    "n_decisions": 3,
    "episodes_per_sample": 2,
}


def step(policy: ObActPolicy, n: int = 2, seed: int = 0) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    shapes = {key: feature.shape for key, feature in policy.config.input_features.items()}
    return {key: torch.rand(n, *shape, generator=generator) for key, shape in shapes.items()}


def hand_policy(**changes: object) -> ObActPolicy:
    torch.manual_seed(0)
    return ObActPolicy(ObActConfig(**TINY | HAND | changes)).eval()


def learner(root: Path, **changes: object) -> ObActPolicy:
    """A policy that is about to learn from recorded episodes."""
    meta = LeRobotDataset("local/tiny", root=root).meta
    torch.manual_seed(0)
    policy = hand_policy(**(RECORDED | changes))
    return ObActPolicy(policy.config, dataset_stats=meta.stats, dataset_meta=meta).train()


# -- training --------------------------------------------------------------------------------------


def test_it_trains_on_a_dataset_that_is_not_ours(push_root, tmp_path, monkeypatch):
    checkpoint = lerobot_train(
        monkeypatch, push_root, tmp_path / "out", head="gr00t", head_options=SMALL_GR00T
    )
    policy = ObActPolicy.from_pretrained(checkpoint)
    assert policy.config.rig.fps == FPS
    assert not policy.config.forecasts
    assert policy.select_action(step(policy)).isfinite().all()


def test_images_in_tables_are_those_that_lerobot_reads(push_root):
    dataset = LeRobotDataset("local/tiny", root=push_root)
    first, second = recordings._images(dataset.meta, "observation.image", [N_FRAMES] * N_EPISODES)
    assert first[3].equal(dataset[3]["observation.image"])
    assert second[5].equal(dataset[N_FRAMES + 5]["observation.image"])


def test_it_learns_from_recorded_episodes_with_the_target_s_path(hand_root, tmp_path, monkeypatch):
    policy = ObActPolicy.from_pretrained(
        lerobot_train(monkeypatch, hand_root, tmp_path / "out", **RECORDED)
    )
    config = policy.config
    assert config.forecasts
    assert set(config.input_features) == {"observation.images.ego", "observation.state"}, (
        "a robot has no phase"
    )
    assert (config.rig.palm_speed_m_s, config.rig.delay_frames) == (0.5, 0), "of class standard"
    pose = config.rig.calibration["observation.images.ego"]
    assert pose[:3] == pytest.approx([-0.15, 0.03, 0.21]), "where the hand's camera is"
    assert policy.select_action(step(policy)).shape == (2, 18)


def test_on_the_contact_track_it_learns_to_close_and_to_hold(contact_root, tmp_path, monkeypatch):
    options = RECORDED | {"virtual_share": 1.0}
    policy = ObActPolicy.from_pretrained(
        lerobot_train(monkeypatch, contact_root, tmp_path / "out", **options)
    )
    assert policy.config.grips
    assert policy.config.rig.palm_speed_m_s == 2.0
    observation = step(policy)
    opened = policy.select_action(observation)
    assert opened.shape == (2, 18)
    policy.reset()
    observation["observation.state"][:, 3:] += 1.0
    assert not policy.select_action(observation).allclose(opened), "the head reads the fingers"


@pytest.mark.parametrize(
    ("changes", "falls"),
    [
        ({"virtual_share": 0.0}, "forecast"),
        ({"virtual_share": 1.0}, "forecast"),
        ({"forecast_weight": 0.0}, "action"),
    ],
    ids=["recorded", "virtual", "actions alone"],
)
def test_the_loss_falls(changes: dict, falls: str, hand_root: Path):
    policy = learner(hand_root, **changes)
    optimizer = torch.optim.Adam(policy.get_optim_params(), lr=3e-3)
    losses = []
    for _ in range(60):
        loss, told = policy(LABELLED)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
        losses.append(told[falls])
    assert ("forecast" in told) == ("closed_loop" in told) == (falls != "action"), (
        "without a path there is neither"
    )
    assert np.mean(losses[-10:]) < 0.85 * np.mean(losses[:10])
    one_each, _ = policy(LABELLED, reduction="none")
    assert one_each.shape == (4,)


def test_the_closed_loop_teaches_forecast_and_head(hand_root: Path):
    pull = {}
    for weight in (0.0, 4.0):
        weights = {"action_weight": 0.0, "forecast_weight": 1e-12, "closed_loop_weight": weight}
        policy = learner(hand_root, episodes_per_sample=8, **weights)
        policy(LABELLED)[0].backward()
        parts = policy.model.head.base, policy.model.when, policy.model.belief.bend[-1]
        pull[weight] = [
            0.0 if part.weight.grad is None else float(part.weight.grad.abs().max())
            for part in parts
        ]
    assert max(pull[0.0]) < 1e-8
    assert min(pull[4.0]) > 1e-6


def rolled_out(
    path: torch.Tensor, state: torch.Tensor, act_once, first: int = 10, late: int = 0
) -> torch.Tensor:
    """The loss of a model on a recorded (1, 60) path and hand, whose palm is rolled out from frame
    ``first`` on.
    """
    full = torch.tensor([60])
    targets = Targets(path, full, full, path, torch.tensor([NEVER]))
    episodes = Episodes(
        torch.zeros(1, 60, 1, 5), state, torch.zeros(1, 60, 18), full, torch.tensor([10]), targets
    )
    config = SimpleNamespace(rig=Rig(delay_frames=late, palm_speed_m_s=0.5))
    model = SimpleNamespace(config=config, device="cpu", act_once=act_once)
    teacher = Teacher(20.0, 0.025, torch.zeros(15), torch.ones(15), 0.03)
    return closed_loop_loss(
        model, torch.zeros(1, 24), episodes, torch.arange(first, first + 24)[None], teacher
    ).sum()


@pytest.mark.parametrize("late", [0, 3])
def test_a_palm_is_rolled_out_from_when_the_first_command_takes_effect(late: int):
    """The palm is near the target in that frame alone, and stays where it is."""
    path = torch.arange(60)[None, :, None] * torch.tensor([0.04, 0.0, 0.0])
    state = torch.full((1, 60, 18), 9.0)
    state[:, 10 + late, :3] = path[:, 10 + late]
    still = lambda outlook, palm, state: palm  # noqa: E731
    assert rolled_out(path, state, still, late=late) < 0.05
    assert rolled_out(path, state, still, first=11, late=late) > 1


@pytest.mark.parametrize("teacher", [Teacher, Grip])
def test_a_training_step_mixes_no_devices(teacher: type[Teacher]):
    """Fake tensors need no GPU, and refuse what one would refuse."""
    rig = Rig(palm_speed_m_s=0.5, capture="contact" if teacher is Grip else "attach")
    views = {
        f"observation.images.{view}": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))
        for view in ("ego", "side")
    }
    inputs = views | {"observation.state": PolicyFeature(FeatureType.STATE, (18,))}
    config = hand_policy(**RECORDED, rig=rig, input_features=inputs).config
    path, full = torch.rand(2, 60, 3), torch.full((2,), 60)
    targets = Targets(path, full, full, path, torch.full((2,), NEVER))
    state = torch.zeros(2, 60, 18)
    episodes = Episodes(
        torch.zeros(2, 60, 2, 5), state, state, full, torch.tensor([10, 12]), targets
    )
    expert = teacher(20.0, 0.025, torch.zeros(15), torch.ones(15), 0.03)
    rows, rolled = episodes.decision_rows(3, 0), rolled_rows(episodes, 0)
    decisions, seen = episodes.decisions(rows, expert, config), torch.cat([rows, rolled], dim=1)
    frames = episodes.frames(seen, 20.0)
    with FakeTensorMode(allow_non_fake_inputs=True), sdpa_kernel(SDPBackend.MATH):
        with torch.device("cuda"):
            model = ObActModel(config)
        outlook = model.encode_history(frames.to("cuda"), seen.to("cuda"))
        losses = decision_losses(model, outlook[:, :3], decisions.to("cuda"))
        losses["closed_loop"] = closed_loop_loss(model, outlook[:, 3:], episodes, rolled, expert)
    assert {loss.device.type for loss in losses.values()} == {"cuda"}


def test_virtual_hands_stay_where_they_are_when_the_policy_moves(hand_root: Path, monkeypatch):
    monkeypatch.setattr(
        "lerobot_policy_obact.virtual_episodes.USES", 0
    )  # each call plays episodes of its own
    policy = learner(hand_root, virtual_share=1.0)
    policy(LABELLED)
    leader = deepcopy(policy.acting)
    policy.to("meta")  # a device that holds no numbers, so whoever reads its tensors fails
    assert policy.virtual.draw(2, leader).sightings.isfinite().all()


def test_the_closed_loop_loss_falls_where_the_head_learns_to_meet_the_target():
    """A head that sends every palm to one place, and a target that waits 12 cm away."""
    path, goal = (
        torch.tensor([0.1, 0.05, -0.05]).expand(1, 60, 3),
        torch.zeros(3, requires_grad=True),
    )
    head = lambda outlook, palm, state: torch.cat([goal.expand(1, 3), state[:, 3:]], dim=1)  # noqa: E731
    optimizer, losses = torch.optim.Adam([goal], lr=0.02), []
    for _ in range(60):
        loss = rolled_out(path, torch.zeros(1, 60, 18), head)
        optimizer.zero_grad()
        loss.backward()
        losses.append(loss.item())
        optimizer.step()
    assert losses[0] > 1.0
    assert losses[-1] < 0.1


@pytest.mark.parametrize("virtual_share", [0.0, 1.0], ids=["recorded", "virtual"])
def test_it_learns_from_no_episode_that_lerobot_holds_out(virtual_share, hand_root, monkeypatch):
    monkeypatch.setattr(
        "lerobot_policy_obact.virtual_episodes.USES", 0
    )  # each call plays episodes of its own
    policy = learner(hand_root, virtual_share=virtual_share, episodes_per_sample=8)

    def named(*episodes: int) -> dict[str, torch.Tensor]:
        return {
            "episode_index": torch.tensor(episodes),
            "action": torch.zeros(len(episodes), 4, 18),
        }

    policy(named(0, 1))
    policy.recordings.episodes.sightings[2:] = torch.nan
    policy.recordings.episodes.targets.path[2:] = torch.nan
    for n in (2, 1, 2):  # the last batch of an epoch is smaller
        loss, _ = policy(named(*range(n)))
        assert loss.isfinite()
    policy.eval()
    assert policy(named(0, 1))[0].isfinite()
    assert policy(named(0, 2))[0].isnan()


def test_fingers_that_need_not_grip_hide_nothing_in_recorded_and_virtual_frames(
    hand_root: Path, monkeypatch
):
    shown, applied = [], SightingErrors.applied
    monkeypatch.setattr(
        SightingErrors, "applied", lambda self, true: shown.append(true) or applied(self, true)
    )
    policy = learner(hand_root, virtual_share=1.0)
    policy(LABELLED)
    assert (policy.virtual.errors[0].true[:, 3] == 0).all()
    assert (torch.cat(shown)[:, 3] == 0).all()


def test_each_camera_starts_from_weights_of_its_own():
    images = {
        f"observation.images.{view}": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))
        for view in ("ego", "side")
    }
    state = {"observation.state": PolicyFeature(FeatureType.STATE, (18,))}
    policy = hand_policy(
        input_features=images | state,
        encoder="eye",
        encoder_options={"weights": "{view}_96"},
        relative_dims=3,
    )
    for eye, name in zip(policy.acting.encoders, ("ego_96", "side_96"), strict=True):
        torch.testing.assert_close(
            eye.attention.query.weight, load_file(SHIPPED[name])["attention.query.weight"]
        )


# -- acting ----------------------------------------------------------------------------------------


def with_processors(policy: ObActPolicy, folder: Path) -> Path:
    """Save a policy as LeRobot's training does."""
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(policy.config):
        processor.save_pretrained(folder)
    return folder


def test_the_average_acts_and_is_exported(tmp_path: Path):
    policy = hand_policy(ema_decay=0.9)
    before = policy.select_action(step(policy))
    for _ in range(2):
        for parameter in policy.model.parameters():
            torch.nn.init.normal_(parameter, std=0.1)
        policy.update()
    policy.reset()
    average = policy.select_action(step(policy))
    assert not torch.equal(average, before)
    training, out = with_processors(policy, tmp_path / "training"), tmp_path / "out"
    for name in ("config.json", "policy_preprocessor.json"):  # as a machine with a GPU writes them
        (training / name).write_text((training / name).read_text().replace('"cpu"', '"cuda"'))
    (training / "train_config.json").write_text('{"steps": 2}')
    export(training, out)
    assert not any('"cuda"' in file.read_text() for file in out.glob("*.json"))
    again = ObActPolicy.from_pretrained(out)
    torch.testing.assert_close(again.select_action(step(policy)), average, rtol=0, atol=0)
    assert again.average is None
    assert {file.name for file in training.iterdir()} == {file.name for file in out.iterdir()}
    assert (out / "train_config.json").read_text() == '{"steps": 2}'


@pytest.mark.parametrize("name", ["obact_standard", "obact_two", "obact_contact"])
def test_a_checkpoint_that_ships_acts(name: str):
    policy = ObActPolicy.from_pretrained(SHIPPED_POLICY.with_name(name))
    assert policy.select_action(step(policy)).isfinite().all()
    assert policy.config.forecasts


@torch.no_grad()
def varied(**changes: object) -> ObActPolicy:
    """A policy whose draws differ."""
    policy = hand_policy(n_action_steps=1, obs_stride=1, **changes)
    for parameter in policy.acting.parameters():
        parameter.add_(0.05 * torch.randn_like(parameter))
    return policy


def played(policy: ObActPolicy, rows: list[int], frames: int = 4) -> torch.Tensor:
    """The actions of some of 32 environments, ``(T, B, A)``."""
    policy.reset()
    seen = [step(policy, n=32, seed=i) for i in range(frames)]
    return torch.stack(
        [policy.select_action({key: x[rows] for key, x in batch.items()}) for batch in seen]
    )


def test_an_action_follows_from_what_was_seen_and_not_from_batch_order_interruption_or_chance():
    policy, everyone = varied(), list(range(32))
    together = played(policy, everyone)
    torch.manual_seed(7)
    played(policy, [3], frames=2)  # an episode that is interrupted
    for rows in ([5], [2, 30], everyone[::-1]):
        torch.testing.assert_close(played(policy, rows), together[:, rows], atol=0, rtol=0)
    again = played(varied(), [5])
    torch.testing.assert_close(again, together[:, [5]], atol=0, rtol=0)
    assert (played(varied(noise_seed=1), [5]) - again).abs().max() > 1e-3


def test_every_frame_has_noise_of_its_own():
    policy = varied(n_obs_frames=0)
    batch = step(policy)
    first, second = policy.select_action(batch), policy.select_action(batch)
    assert (first - second).abs().max() > 1e-3


def test_frames_that_were_dropped_count_as_time_that_passed_also_between_chunks():
    policy = varied(n_obs_frames=None)
    seen = [
        step(policy, seed=i) | {"timestamp": torch.tensor([t])}
        for i, t in enumerate((0.0, 0.1, 0.5))
    ]

    def acted(batches: list[dict], act=policy.select_action) -> torch.Tensor:
        policy.reset()
        return torch.stack([act(batch) for batch in batches])

    with_drops = acted(seen)
    on_time = acted([{key: x for key, x in batch.items() if key != "timestamp"} for batch in seen])
    torch.testing.assert_close(with_drops[0], on_time[0])
    assert not torch.equal(with_drops[2], on_time[2])
    chunks = acted(seen, policy.predict_action_chunk)
    torch.testing.assert_close(chunks[:, :, 0], with_drops)
    by_the_clock = acted(
        [batch | {"timestamp": batch["timestamp"].double() + 1.7e9} for batch in seen]
    )
    torch.testing.assert_close(by_the_clock, with_drops, atol=1e-4, rtol=0)


def test_a_window_reaches_back_over_frames_that_were_dropped():
    policy = varied(n_obs_frames=5)

    def later(first: int) -> torch.Tensor:
        policy.reset()
        policy.select_action(step(policy, seed=first) | {"timestamp": torch.tensor([0.0])})
        return policy.select_action(step(policy, seed=9) | {"timestamp": torch.tensor([0.35])})

    assert not torch.equal(later(1), later(2))


def test_frames_are_ticks_of_the_robots_clock_however_often_and_late_a_caller_asks(monkeypatch):
    policy = varied(n_obs_frames=None)
    clock = chain([100.0, 100.02, 100.06, 100.09, 100.16], repeat(0.0))  # ticks 0, 0, 1, 2 and 3
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    hurried = [policy.predict_action_chunk(step(policy, seed=i)) for i in (0, 0, 1, 2, 3)]
    policy.reset()
    regular = [
        policy.predict_action_chunk(step(policy, seed=i) | {"timestamp": torch.tensor([0.05 * i])})
        for i in range(4)
    ]
    torch.testing.assert_close(torch.stack(hurried[1:]), torch.stack(regular))


def test_the_last_frame_of_the_episode_before_is_forgotten(monkeypatch):
    policy = varied(n_obs_frames=None)
    clock = chain([100.0, 100.05, 110.0, 110.02, 110.07, 110.12, 0.0, 0.05], repeat(0.0))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    for i in (8, 9):
        policy.predict_action_chunk(step(policy, seed=i))
    policy.reset()
    stale = [policy.predict_action_chunk(step(policy, seed=i)) for i in (9, 9, 0, 1)]
    policy.reset()
    fresh = [policy.predict_action_chunk(step(policy, seed=i)) for i in (0, 1)]
    torch.testing.assert_close(torch.stack(stale[2:]), torch.stack(fresh))


def test_real_time_chunking_guides_no_chunk():
    policy = varied(n_obs_frames=None, horizon=4, rtc_config=RTCConfig(enabled=True))
    assert supports_rtc_inference(policy)
    alone = policy.predict_action_chunk(step(policy))
    policy.reset()
    after = policy.predict_action_chunk(
        step(policy), inference_delay=1, prev_chunk_left_over=torch.rand(2, 3, 18)
    )
    torch.testing.assert_close(after, alone, rtol=0, atol=0)


def test_a_frozen_encoder_that_describes_more_than_a_sighting_learns_from_recorded_hands(hand_root):
    policy = learner(
        hand_root, encoder="conv", encoder_options={}, virtual_share=1.0, cache_images=False
    )
    loss, told = policy(LABELLED)
    assert loss.isfinite()
    assert "forecast" in told


def test_a_decision_tells_what_it_saw_expects_and_attends_to():
    policy = varied(n_obs_frames=None)
    assert policy.thought is None
    for i in range(3):
        policy.select_action(step(policy, seed=i))
    thought = policy.thought
    assert thought.sighted.shape == (2, 1, 3)
    assert thought.forecast.shape == (2, len(thought.ahead_s), 3)
    assert thought.meeting.shape == (2, 3)
    assert thought.weights.shape == (2, 4, 3), "of three frames observed, in four readouts"
    torch.testing.assert_close(thought.weights.sum(-1), torch.ones(2, 4), check_dtype=False)


def test_another_number_of_environments_needs_a_reset():
    policy = hand_policy(n_action_steps=1)
    policy.select_action(step(policy, n=2))
    with pytest.raises(ValueError, match="from 2 to 3 environments"):
        policy.select_action(step(policy, n=3))
    policy.reset()
    assert policy.select_action(step(policy, n=3)).shape == (3, 18)


def test_lerobot_s_policy_server_serves_it(tmp_path: Path):
    with_processors(hand_policy(), tmp_path)
    joints = [f"joint_{i}" for i in range(18)]
    features = {
        "observation.state": {"dtype": "float32", "shape": (18,), "names": joints},
        "observation.images.ego": {
            "dtype": "image",
            "shape": (32, 32, 3),
            "names": ["h", "w", "c"],
        },
    }
    specs = RemotePolicyConfig("obact", str(tmp_path), features, actions_per_chunk=3, device="cpu")
    assert "obact" in SUPPORTED_POLICIES, f"{launch_policy_server} adds it"
    server, client = PolicyServer(PolicyServerConfig()), SimpleNamespace(peer=lambda: "test")
    server.Ready(None, client)
    server.SendPolicyInstructions(SimpleNamespace(data=pickle.dumps(specs)), client)
    image = torch.zeros(32, 32, 3, dtype=torch.uint8).numpy()
    observation = {**dict.fromkeys(joints, 0.1), "ego": image, "task": "catch"}
    actions = server._predict_action_chunk(
        TimedObservation(timestamp=1.0, timestep=7, observation=observation)
    )
    assert [action.get_timestep() for action in actions] == [7, 8, 9]
    assert all(action.get_action().shape == (18,) for action in actions)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("encoder", "camera", "eye, conv"),
        ("head", "arm", "diffusion, flow, regression, gr00t"),
        ("n_obs_frames", -1, "0 to 200"),
        ("relative_dims", 19, "0 to 18"),
        ("n_action_steps", 9, "1 to 4"),
        ("head_options", {"n_steps": 10**6}, "1 to 100"),
        ("head_options", {"n_draws": 0}, "1 to 100"),
    ],
)
def test_a_wrong_option_is_named_with_what_is_allowed(name: str, value: object, allowed: str):
    with pytest.raises(ValueError, match=f"{name}.* {allowed}"):
        hand_policy(**{name: value})


ALONE = """if True:
    import sys
    sys.modules["dynahoi_lerobot"] = None  # whoever imports it fails
    import torch
    from lerobot.datasets import LeRobotDataset
    from lerobot_policy_obact import ObActPolicy
    checkpoint, root, out = sys.argv[1:]
    policy, seen = ObActPolicy.from_pretrained(checkpoint), torch.load(f"{out}/seen.pt")
    torch.save(torch.stack([policy.select_action(batch) for batch in seen]), f"{out}/actions.pt")
    training = {"teacher", "decisions", "recordings", "virtual_episodes"}
    ours = [name for name in sys.modules if name.startswith("lerobot_policy_obact")]
    assert not training & {name.split(".")[-1] for name in ours}
    import lerobot_policy_obact.virtual_episodes
    lerobot_policy_obact.virtual_episodes.POOL = 1
    meta = LeRobotDataset("local/tiny", root=root).meta
    given = {"dataset_stats": meta.stats, "dataset_meta": meta, "load_pretrained": False}
    policy = ObActPolicy(policy.config, **given).train()
    loss, told = policy({"episode_index": torch.arange(4), "action": torch.zeros(4, 4, 18)})
    loss.backward()
    assert {"forecast", "action", "closed_loop"} <= set(told)
    assert policy.select_action(seen[0]).isfinite().all()
"""


def test_another_process_without_the_core_acts_the_same_and_trains(hand_root: Path, tmp_path: Path):
    """What labels episodes is imported for training alone, and nothing of the core at all."""
    policy = varied(
        **RECORDED | {"cache_images": False, "virtual_share": 1.0, "episodes_per_sample": 1}
    )
    policy.save_pretrained(tmp_path / "checkpoint")
    seen = [step(policy, n=2, seed=i) for i in range(3)]
    torch.save(seen, tmp_path / "seen.pt")
    python("-c", ALONE, tmp_path / "checkpoint", hand_root, tmp_path)
    actions = torch.stack([policy.select_action(batch) for batch in seen])
    torch.testing.assert_close(torch.load(tmp_path / "actions.pt"), actions, atol=1e-4, rtol=0)


def test_what_learned_from_the_targets_path_is_not_trained_where_there_is_none(
    hand_root: Path, tmp_path: Path, monkeypatch
):
    config = learner(hand_root).config
    config.pretrained_path = Path("ours")
    monkeypatch.setattr(recordings, "describe", lambda meta, cameras: Rig(fps=20.0))
    with pytest.raises(
        ValueError, match="ours learned from the target's path, which local/other lacks"
    ):
        ObActPolicy(config, dataset_meta=SimpleNamespace(repo_id="local/other", root=tmp_path))
