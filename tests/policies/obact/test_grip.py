"""The contact track: labels of the expert `match`, hands that grip, and what is learned of them."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.utils.feature_utils import dataset_to_policy_features
from lerobot_policy_obact import ObActConfig, ObActPolicy
from lerobot_policy_obact.dataset import TargetTable
from lerobot_policy_obact.forecaster import Forecast
from lerobot_policy_obact.frames import Frames, stepped
from lerobot_policy_obact.grip import GRIP_M, Grip
from lerobot_policy_obact.losses import window_losses
from lerobot_policy_obact.teacher import Targets, Teacher
from lerobot_policy_obact.windows import VirtualHands, Window
from torch.utils.data import DataLoader

from dynahoi_lerobot.encode import encode
from dynahoi_lerobot.experts.match import SEAT_M, braked
from tests.checkpoints import TINY_OBACT, observation, window_of
from tests.tools import generated

SEAT = torch.tensor(SEAT_M, dtype=torch.float32)
OPTIONS = TINY_OBACT | {
    "encoder": "",
    "encoder_options": {},
    "freeze_encoder": None,
    "horizon": 4,
    "n_obs_steps": 13,
    "n_future_steps": 24,
    "delayed_share": 0.0,
    "device": "cpu",
    "push_to_hub": False,
}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four encoded recordings of the contact track."""
    folder = tmp_path_factory.mktemp("contact")
    options = ("--capture", "contact", "--expert", "match", "--image-size", "96")
    encode(generated(folder / "images", *options, episodes=4), folder / "encoded")
    return folder / "encoded"


def metadata(root: Path) -> LeRobotDatasetMetadata:
    return LeRobotDatasetMetadata("local/contact", root=root)


def learner(root: Path, **changes: object) -> ObActPolicy:
    meta = metadata(root)
    features = dataset_to_policy_features(meta.features)
    outputs = {"action": features.pop("action")}
    torch.manual_seed(0)
    config = ObActConfig(**OPTIONS | changes, input_features=features, output_features=outputs)
    return ObActPolicy(config, dataset_stats=meta.stats, dataset_meta=meta).train()


def recorded(policy: ObActPolicy, root: Path) -> LeRobotDataset:
    times = resolve_delta_timestamps(policy.config, metadata(root))
    return LeRobotDataset("local/contact", root=root, delta_timestamps=times)


def batch_of(policy: ObActPolicy, root: Path) -> dict[str, torch.Tensor]:
    """All frames of the recordings, in their order."""
    data = recorded(policy, root)
    return next(iter(DataLoader(data, batch_size=len(data))))


def table_of(policy: ObActPolicy) -> TargetTable:
    assert policy.targets is not None
    return policy.targets


def grip() -> Grip:
    return Grip(20.0, 0.1, torch.zeros(15), torch.full((15,), 1.3), GRIP_M)


def still_targets(place: torch.Tensor, n: int) -> Targets:
    known = torch.full((n,), 8)
    return Targets(place.expand(n, 8, 3), known, known, torch.zeros(n, dtype=torch.bool))


def test_its_answers_are_the_goals_that_the_expert_recorded(root: Path):
    policy = learner(root)
    table = table_of(policy)
    batch = batch_of(policy, root)
    episode = batch["episode_index"]
    frame = batch["frame_index"]
    open_hand = (frame >= table.begin[episode]) & (frame < table.catch[episode])
    assert open_hand.sum() > 20
    now = policy.config.n_obs_steps - 1
    state = batch["observation.state"][open_hand, now, None, None]
    targets, _ = table.window(episode[open_hand], frame[open_hand], [0])
    due = torch.zeros(len(state), 1, dtype=torch.long)
    told = table.teacher.answer(targets, due, state, 1)
    goals = batch["action"][open_hand, 0]
    # a finger may have touched the target by then
    torch.testing.assert_close(told.goal[:, 0, 0, 0], goals[:, :3], atol=2e-3, rtol=0)
    joints = table.teacher.joints(told.closing[:, 0, 0, 0])
    torch.testing.assert_close(joints, goals[:, 3:], atol=0.15, rtol=0)
    assert told.closing.sum() == 4, "each hand closes in one frame"


def test_a_hand_that_follows_the_answers_grips_its_target():
    torch.manual_seed(0)
    start = torch.tensor([0.3, 0.0, 0.0]) + 0.1 * torch.randn(64, 1, 3)
    path = start + torch.arange(90)[:, None] * 0.015 * torch.rand(64, 1, 3)
    known = torch.full((64,), 90)
    targets = Targets(path, known, known, torch.zeros(64, dtype=torch.bool))
    hand = grip()
    way = [torch.cat([torch.zeros(64, 3), hand.open_joints.expand(64, -1)], dim=1)]
    for t in range(80):
        told = hand.answer(targets, torch.full((64, 1), t), way[-1][:, None, None], 1)
        palm = stepped(way[-1][:, :3], told.goal[:, 0, 0, 0], 0.1)
        way.append(torch.cat([palm, hand.joints(told.closing[:, 0, 0, 0])], dim=1))
    states = torch.stack(way, dim=1)
    caught = hand.caught(states[..., :3] - path[:, :81], states[..., 3:])
    assert caught.any(1).float().mean() > 0.9
    assert not caught[:, 0].any(), "far from it, nothing is caught"


def test_a_palm_that_passes_its_target_meets_it_but_does_not_grip_it():
    frames = torch.arange(-5, 6)[:, None]
    passes = frames * torch.tensor([0.0, 0.04, 0.0])
    stays = (frames.abs() > 2) * torch.tensor([0.0, 0.2, 0.0])
    hand = grip()
    meets = Teacher(hand.fps, hand.step_m, hand.open_joints, hand.closed_joints, 0.03)
    assert float(meets.misses(passes[None]).min()) < 0.001
    assert float(hand.misses((passes - SEAT)[None]).min()) == pytest.approx(0.04, abs=1e-4)
    assert float(hand.misses((stays - SEAT)[None]).min()) < 0.001


def test_closed_fingers_hold_a_target_near_its_seat():
    hand = grip()
    offsets = torch.tensor([[0.0, 0, 0], [0.04, 0, 0], [0.2, 0, 0]]) - SEAT
    opened = hand.holds(offsets, hand.open_joints.expand(3, -1))
    closed = hand.holds(offsets, hand.closed_joints.expand(3, -1))
    assert opened.tolist() == [False] * 3
    assert closed.tolist() == [True, True, False]


def test_other_hands_of_a_decision_have_their_fingers_anywhere():
    hand = grip()
    torch.manual_seed(0)
    state = torch.zeros(2000, 1, 18)
    due = torch.zeros(2000, 1, dtype=torch.long)
    closed = (
        hand.hands(still_targets(torch.ones(3), 2000), due, state)[:, 0, :, 3:] / hand.closed_joints
    )
    assert (closed[:, 0] == 0).all()
    others = closed[:, 1:]
    assert torch.equal(others, others[..., :1].expand_as(others)), "all fingers alike"
    drawn = others[..., 0][others[..., 0] > 0]
    assert 0.4 < len(drawn) / 6000 < 0.6
    assert 0.2 < float(drawn.quantile(0.25)) < 0.3
    assert 0.7 < float(drawn.quantile(0.75)) < 0.8


def test_before_the_grip_a_target_goes_its_way_and_then_it_goes_with_the_hand(root: Path):
    table = table_of(learner(root))
    truth = pq.read_table(root / "meta" / "privileged").to_pandas().set_index("episode_index")
    places = torch.tensor(truth.loc[0].sort_values("frame_index")["target.pose"].tolist())[:, :3]
    catch = int(table.catch[0])
    newest = torch.tensor([catch - 1, catch])
    targets, _ = table.window(torch.zeros(2, dtype=torch.long), newest, [-1, 0, 1, 2, 3, 4])
    assert targets.gripped.tolist() == [False, True]
    torch.testing.assert_close(targets.path[0, :6], table.path[0, catch - 2 : catch + 4])
    torch.testing.assert_close(targets.path[1, :6], places[catch - 1 : catch + 5].float())
    ways = table.path[0, catch + 20] - places[catch + 20]
    assert ways.norm() > 0.02, "the two are different"


def test_a_hand_that_grips_is_shown_as_it_was_and_learns_what_it_did(root: Path):
    policy = learner(root)
    window = window_of(policy, batch_of(policy, root))
    targets = window.targets
    assert isinstance(targets, Targets)
    assert 0.2 < targets.gripped.float().mean() < 0.9
    held = window[targets.gripped]
    torch.manual_seed(0)
    shown = VirtualHands(table_of(policy).teacher, policy.model).drawn(held.repeated(2), 0.8)
    torch.testing.assert_close(shown.frames.state, held.repeated(2).frames.state)
    row = policy.config.n_obs_steps
    seen = held.repeated(2).frames.sightings
    torch.testing.assert_close(shown.frames.sightings[:, :row], seen[:, :row], atol=1e-3, rtol=1e-3)
    losses = {}
    for name, change_m in (("as recorded", 0.0), ("elsewhere", 0.5)):
        for whose, some in (("held", held), ("free", window[~targets.gripped])):
            moved = replace(some, actions=some.actions + change_m)
            torch.manual_seed(0)
            found = window_losses(policy.model, moved, table_of(policy).teacher)
            losses[whose, name] = float(found["action"].mean())
    assert losses["held", "elsewhere"] > 2 * losses["held", "as recorded"]
    assert losses["free", "elsewhere"] == losses["free", "as recorded"], "the expert's labels"


def test_a_hand_that_grips_learns_what_it_did_when_inference_ended(root: Path):
    policy = learner(root)
    batch = batch_of(policy, root)
    window = Window.of(batch, policy.model, policy.targets, 3)
    torch.testing.assert_close(window.actions[:, 0], batch["action"][:, 3])
    torch.testing.assert_close(window.action_weight[:, 0], (~batch["action_is_pad"][:, 3]).float())
    assert not window.action_weight[:, 1:].any(), "nothing later was loaded"


def test_a_hand_that_grips_learns_in_the_current_frame_however_long_the_history(
    root: Path, monkeypatch: pytest.MonkeyPatch
):
    policy = learner(root, n_obs_steps=120)
    window = window_of(policy, batch_of(policy, root))
    assert window.targets is not None
    held = window[window.targets.gripped]
    decided = []
    encode_history = policy.model.encode_history

    def noting(frames: Frames, decided_at: torch.Tensor) -> Forecast:
        decided.append(decided_at)
        return encode_history(frames, decided_at)

    monkeypatch.setattr(policy.model, "encode_history", noting)
    window_losses(policy.model, held, table_of(policy).teacher)
    assert (decided[0][:, : policy.config.n_decisions] == 119).all()


@pytest.mark.parametrize(
    ("closed", "distance_m", "closes"),
    [
        (0.6, 0.045, True),
        (0.6, 0.055, False),
        (0.3, 0.034, True),
        (0.3, 0.036, False),
        (0.1, 0.034, False),
    ],
)
def test_fingers_that_have_begun_to_close_around_a_target_go_on(
    closed: float, distance_m: float, *, closes: bool
):
    hand = grip()
    place = torch.tensor([0.0, 0.1, 0.2])
    palm = place - SEAT + torch.tensor([distance_m, 0.0, 0.0])  # beyond where the expert closes
    joints = torch.lerp(hand.open_joints, hand.closed_joints, closed)
    hands = torch.cat([palm, joints])[None, None, None]
    due = torch.zeros(1, 1, dtype=torch.long)
    told = hand.answer(still_targets(place, 1), due, hands, 1)
    assert told.closing.item() == closes


def test_a_hand_that_holds_its_target_brakes_as_the_expert_does():
    hand = grip()
    place = torch.tensor([0.0, 0.1, 0.2])
    speed = torch.tensor([0.0, 0.5, -0.25])  # [m/s]
    path = place + torch.arange(8)[:, None] * speed / hand.fps
    targets = replace(still_targets(place, 1), path=path[None])
    hands = torch.cat([place - SEAT + 0.01, hand.closed_joints])[None, None, None]
    told = hand.answer(targets, torch.zeros(1, 1, dtype=torch.long), hands, 2)
    goals = told.goal[0, 0, 0]
    velocities = (goals - torch.stack([hands[0, 0, 0, :3], goals[0]])) * hand.fps
    first = braked(speed.double().numpy())
    expected = torch.from_numpy(np.stack([first, braked(first)]))
    torch.testing.assert_close(velocities.double(), expected, atol=1e-5, rtol=0)


def test_a_target_is_caught_once_it_was_held_for_some_frames():
    hand = grip()
    near = torch.tensor([0, 1, 1, 0, 1, 1, 1, 1], dtype=torch.bool)
    offsets = torch.where(near[:, None], 0.0, 0.2) - SEAT
    joints = hand.closed_joints.expand(8, -1)
    caught = hand.caught(offsets[None], joints[None])
    assert caught.tolist() == [[False] * 5 + [True, True]]


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_in_a_short_window_a_target_is_caught_that_is_held_throughout(frames: int):
    hand = grip()
    offsets = -SEAT.expand(1, frames, 3)
    joints = hand.closed_joints.expand(1, frames, -1)
    caught = hand.caught(offsets, joints)
    assert caught.shape == (1, frames - 1), "one for each frame after the first"
    assert caught[:, -1:].all()
    assert not hand.caught(offsets + 0.2, joints).any()
    assert hand.misses(offsets).shape == (1, 1)


@pytest.mark.parametrize("far", [True, False])
def test_fingers_of_led_hands_follow_the_head(root: Path, monkeypatch, *, far: bool):
    """One that closes them far from its target does not hold it; near it, it has caught it."""
    monkeypatch.setattr("lerobot_policy_obact.windows.START_M", 0.0)
    policy = learner(root)
    window = window_of(policy, batch_of(policy, root))
    assert window.targets is not None
    free = window[~window.targets.gripped & (window.begin < 3)]
    teacher = table_of(policy).teacher
    closed = teacher.joints(torch.ones(()))

    def act_once(forecast: Forecast, palm: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        goal = palm - 1.0 if far else palm
        return torch.cat([goal, closed.expand(len(palm), -1)], dim=-1)

    monkeypatch.setattr(policy.model, "act_once", act_once)
    if not far:  # targets that wait in the seats of their hands
        path = free.frames.palm[:, :1] + SEAT
        path = path.expand_as(free.targets.path)
        free = replace(free, targets=replace(free.targets, path=path))
    hands = VirtualHands(teacher, policy.model)
    torch.manual_seed(0)
    shown = hands.drawn(free, 1.0)
    assert shown.targets is not None
    joints = shown.frames.state[..., 3:]
    torch.testing.assert_close(joints[:, -1], closed.expand_as(joints[:, -1]))
    caught = shown.targets.catch < joints.shape[1]
    assert caught.float().mean() < 0.2 if far else caught.float().mean() > 0.8


def test_a_training_rolls_palms_out_and_its_checkpoint_acts_without_the_expert(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    policy = learner(root)
    loss, logged = policy.forward(batch_of(policy, root))
    loss.backward()
    assert logged["closed_loop"] > 0
    policy.save_pretrained(tmp_path)
    monkeypatch.setitem(sys.modules, "dynahoi_lerobot.experts.match", None)
    monkeypatch.delitem(sys.modules, "lerobot_policy_obact.grip")
    opened = ObActPolicy.from_pretrained(tmp_path)
    batch = observation(opened.config, 2, 0)
    assert opened.select_action(batch).shape == (2, 18)
    with pytest.raises(ImportError, match=r"install lerobot_policy_obact\[contact\]"):
        learner(root)
