"""Windows and the hands in them: what is seen from elsewhere, who leads, what is learned."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from lerobot_policy_obact import ObActConfig, ObActPolicy
from lerobot_policy_obact.camera import Pinhole
from lerobot_policy_obact.configuration_obact import Embodiment
from lerobot_policy_obact.forecaster import FORECAST_FRAMES, Forecast
from lerobot_policy_obact.frames import Frames
from lerobot_policy_obact.losses import closed_loop_loss, window_losses
from lerobot_policy_obact.network import ObActModel
from lerobot_policy_obact.teacher import LONGEST_FRAMES, Targets, Teacher
from lerobot_policy_obact.windows import RecordedErrors, VirtualHands, Window
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.nn.attention import SDPBackend, sdpa_kernel

from tests.checkpoints import FEATURES, TINY_OBACT, fit

PAST = 13
FUTURE = 24
LENGTH = PAST + FUTURE
LOOKS_ALONG_X = [-0.15, 0.03, 0.21, 0.5, 0.5, -0.5, -0.5]
"""Pose of a camera behind the palm that looks along +x, with z up."""
CALIBRATION = {"observation.images.ego": [*LOOKS_ALONG_X, 0.9, 1.0]}
STEP_M = 0.025
RADIUS_M = 0.03


def camera() -> Pinhole:
    return Pinhole.from_pose(LOOKS_ALONG_X, 0.9, carried=True)


def teacher() -> Teacher:
    return Teacher(20.0, STEP_M, torch.zeros(15), torch.ones(15), RADIUS_M)


def windows(
    b: int = 64, error: torch.Tensor | float = 0.0, begin: int = 5, length: int = LENGTH
) -> Window:
    """Windows in which hands at rest watch targets pass in straight lines, all of them in view; the
    eye errs by ``error``.
    """
    generator = torch.Generator().manual_seed(0)
    start = torch.tensor([0.4, 0.0, 0.0]) + 0.02 * torch.randn(b, 1, 3, generator=generator)
    speed = 0.002 * torch.randn(b, 1, 3, generator=generator)
    n = LENGTH + LONGEST_FRAMES
    path = start + torch.arange(n)[:, None] * speed
    full = torch.full((b,), n)
    targets = Targets(path, full, full, torch.zeros(b, dtype=torch.bool))
    state = torch.zeros(b, length, 18)
    view = camera().project(path[:, :length]) + error
    sightings = torch.cat([view, torch.full((b, length, 2), -2.0)], dim=-1)[:, :, None]
    hidden = torch.zeros(b, length, dtype=torch.bool)
    frames = Frames(sightings, state, torch.arange(length) / 20.0, hidden)
    actions = torch.zeros(b, 8, 18)
    weight = torch.ones(b, 8)
    return Window(frames, ~hidden, actions, weight, torch.full((b,), begin), 0, targets)


def policy(**changes: object) -> ObActPolicy:
    torch.manual_seed(0)
    embodiment = Embodiment(calibration=CALIBRATION, palm_speed_m_s=0.5, capture="attach")
    options = {
        "encoder": "eye",
        "freeze_encoder": True,
        "n_obs_steps": PAST,
        "n_future_steps": FUTURE,
        "embodiment": embodiment,
    }
    return ObActPolicy(ObActConfig(**TINY_OBACT | options | FEATURES | changes))


def hands(actor: ObActPolicy | None = None) -> VirtualHands:
    actor = actor or policy()
    return VirtualHands(teacher(), actor.model)


# -- transplanted sightings ------------------------------------------------------------------------


def seen_from(palm: torch.Tensor, window: Window) -> torch.Tensor:
    """What palms at (B, L, 3) would have seen of the targets of windows, (B, L, 5)."""
    path = window.targets.path[:, :LENGTH]
    return RecordedErrors(window, [camera()]).seen(path, palm)[:, :, 0]


def view_from(palm: torch.Tensor, window: Window) -> torch.Tensor:
    """Where their targets truly are in the view, (B, L, 3)."""
    return camera().project(window.targets.path[:, :LENGTH] - palm)


def test_from_another_palm_the_true_view_is_seen_with_the_error_of_the_same_frame():
    error = torch.randn(64, 1, 3) * 0.02
    window = windows(error=error)
    palm = window.frames.palm + torch.tensor([0.0, 0.02, -0.01])
    seen = seen_from(palm, window)
    wanted = (view_from(palm, window) + error)[..., :2]
    torch.testing.assert_close(seen[..., :2], wanted, atol=1e-4, rtol=0)
    assert (seen[..., 3:] == -2).all(), "and is as sure of it"


def test_errors_of_the_depth_grow_with_the_distance():
    window = windows(error=torch.tensor([0.0, 0.0, 0.1]))
    far = window.frames.palm - torch.tensor([0.1, 0.0, 0.0])
    found = seen_from(far, window)[..., 2] - view_from(far, window)[..., 2]
    assert (found > 0.1).all()
    assert (found < 0.2).all()


def test_what_was_seen_of_nothing_is_seen_again_where_the_target_is_out_of_view():
    window = windows()
    behind = replace(window.targets, path=window.targets.path - torch.tensor([2.0, 0.0, 0.0]))
    nothing = torch.full_like(window.frames.sightings, 0.3)
    window = replace(window, targets=behind, frames=replace(window.frames, sightings=nothing))
    palm = window.frames.palm + 0.1 * torch.randn(64, 1, 3)
    assert (seen_from(palm, window) == 0.3).all()


def test_frames_after_the_catch_lend_no_errors():
    error = torch.zeros(64, LENGTH, 3)
    error[:, 20:] = 5.0  # what the eye makes of a target in the hand
    window = windows(error=error)
    window = replace(window, targets=replace(window.targets, catch=torch.full((64,), 20)))
    palm = window.frames.palm
    seen = seen_from(palm, window)[..., :3]
    torch.testing.assert_close(seen, view_from(palm, window), atol=1e-3, rtol=0)


# -- hands -----------------------------------------------------------------------------------------


def test_recorded_hands_are_shown_as_they_were():
    window = windows(error=0.05 * torch.randn(64, LENGTH, 3), begin=PAST + 3)
    shown = hands().drawn(window, 0.0)
    torch.testing.assert_close(shown.frames.state, window.frames.state)
    torch.testing.assert_close(shown.frames.sightings, window.frames.sightings, atol=1e-4, rtol=0)


@pytest.mark.parametrize("late", [0, 3])
def test_virtual_hands_wait_until_they_may_move_and_go_no_faster_than_they_can(late: int):
    """However late commands take effect: the first that counts is given before that frame."""
    shown = hands().drawn(replace(windows(begin=20), delay_frames=late), 1.0)
    steps = shown.frames.palm.diff(dim=1).norm(dim=-1)
    waits = torch.arange(LENGTH - 1) < shown.begin[:, None]
    assert steps.max() <= STEP_M + 1e-5
    assert (steps[waits] == 0).all()
    assert (steps[~waits] > 0).all()


@pytest.mark.parametrize("late", [0, 3])
@pytest.mark.parametrize(
    ("begin", "n_hidden", "moves"),
    [
        (PAST + 4, 0, PAST + 4),
        (7, 2, 7),  # in a window that shows the episode from its first frame on
        (4, 6, 6),  # in one that does not show when it could first move
        (7, 0, PAST - 1),  # in a later one, whose first rows have seen too little
        (LENGTH + 9, 0, LENGTH - 1),
    ],
)
def test_the_first_decision_is_the_one_that_moves_the_hand(
    monkeypatch: pytest.MonkeyPatch, late: int, begin: int, n_hidden: int, moves: int
):
    decided = {}

    def decision_losses(*args: Any) -> dict[str, torch.Tensor]:
        decided["imitation"] = args[3]
        return {}

    def closed_loop_loss(*args: Any) -> torch.Tensor:
        decided["closed loop"] = args[3]
        return torch.zeros(len(args[3]))

    monkeypatch.setattr("lerobot_policy_obact.losses.decision_losses", decision_losses)
    monkeypatch.setattr("lerobot_policy_obact.losses.closed_loop_loss", closed_loop_loss)
    window = replace(windows(begin=begin), delay_frames=late)
    hidden = torch.arange(LENGTH).expand(64, -1) < n_hidden
    window = replace(window, frames=replace(window.frames, hidden=hidden))
    window_losses(policy().model, window, teacher())
    earliest = n_hidden or PAST - 1
    first = max(earliest, moves - late)
    assert (decided["closed loop"][:, 0] == first).all()
    assert decided["imitation"].min() == first


@pytest.mark.parametrize("late", [0, 3])
def test_after_the_window_the_closed_loop_goes_on_with_the_last_forecast(
    monkeypatch: pytest.MonkeyPatch, late: int
):
    """Targets that are one meter farther in every frame, in the forecasts."""
    read = []

    def closed_loop_loss(*args: Any) -> torch.Tensor:
        read.append(args[1].places[..., 0, 0])
        return torch.zeros(len(args[1].places))

    monkeypatch.setattr("lerobot_policy_obact.losses.closed_loop_loss", closed_loop_loss)
    actor = policy()
    monkeypatch.setattr(actor.model, "encode_history", one_meter_a_frame)
    window = replace(windows(begin=PAST + 10), delay_frames=late)
    window_losses(actor.model, window, teacher())
    wanted = PAST + 10 + torch.arange(FUTURE).float()
    torch.testing.assert_close(read[0], wanted.expand(64, -1))
    assert wanted[-1] > LENGTH


def test_a_virtual_hand_decides_until_it_has_caught_its_target(monkeypatch: pytest.MonkeyPatch):
    window = windows()
    begin = torch.where(torch.arange(64) % 2 == 0, 0, LENGTH - 5)  # half of them begin too late
    leader = hands()
    goal = torch.nn.functional.pad(window.targets.path[:, 20], (0, 15))
    monkeypatch.setattr(leader.model, "act_once", lambda f, palm, state: goal)
    shown = leader.drawn(replace(window, begin=begin), 1.0)
    offset = shown.frames.palm - shown.targets.path[:, :LENGTH]
    targets = shown.targets
    near = teacher().misses(offset) < teacher().radius_m
    frame = torch.arange(1, LENGTH)
    assert not near[frame < targets.catch[:, None]].any()
    caught = near.any(1)
    assert 0 < caught.sum() < len(caught), "some catch it in the window, some do not"
    assert near[caught].gather(1, targets.catch[caught, None] - 1).all()
    assert (targets.catch[~caught] == targets.length[~caught]).all()


def test_where_nothing_is_to_be_decided_only_the_forecast_is_learned():
    window = windows()
    actor = policy(closed_loop_weight=0.0)
    caught = replace(window, targets=replace(window.targets, catch=torch.full((64,), PAST - 1)))
    losses = window_losses(actor.model, caught, teacher())
    assert losses["action"].abs().max() == losses["missed"].abs().max() == 0
    assert losses["forecast"].min() > 0
    decided = window_losses(actor.model, window, teacher())
    assert decided["missed"].min() > 0


@pytest.mark.parametrize(("past", "future"), [(1, 0), (1, 1), (2, 2), (13, 3), (1, 24)])
@pytest.mark.parametrize("late", [0, 3])
def test_windows_may_be_short(past: int, future: int, late: int):
    actor = policy(n_obs_steps=past, n_future_steps=future)
    window = replace(windows(length=past + future), delay_frames=late)
    shown = hands(actor).drawn(window, 0.8)
    assert shown.frames.palm.shape == (64, past + future, 3)
    losses = window_losses(actor.model, shown, teacher())
    assert all(loss.isfinite().all() for loss in losses.values())


def test_a_led_hand_reads_the_forecast_of_when_its_commands_take_effect(
    monkeypatch: pytest.MonkeyPatch,
):
    """Targets that are one meter farther in every frame, in the forecasts."""
    late = 4
    leader = hands()
    asked = []

    def act_once(forecast: Forecast, palm: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        asked.append(float(forecast.places[0, 0, 0]))
        return torch.zeros(len(palm), 18)

    monkeypatch.setattr(leader.model, "encode_history", one_meter_a_frame)
    monkeypatch.setattr(leader.model, "act_once", act_once)
    leader.drawn(replace(windows(begin=0), delay_frames=late), 1.0)
    assert asked == [float(frame) for frame in range(late, LENGTH - 1)]


def test_only_hands_in_the_middle_of_their_way_start_off_the_recorded_one():
    waiting, moving = (hands().drawn(windows(begin=begin), 1.0) for begin in (1, 0))
    assert (waiting.frames.palm[:, 0] == 0).all()
    away = moving.frames.palm[:, 0].norm(dim=-1)
    assert (away > 0).all()
    assert 0.005 < float(away.median()) < 0.1


def test_a_hand_that_the_policy_leads_follows_its_head(monkeypatch: pytest.MonkeyPatch):
    corner = torch.tensor([5.0, -5.0, 5.0])
    leader = hands()
    goal = torch.cat([corner, torch.zeros(15)])
    monkeypatch.setattr(leader.model, "act_once", lambda f, palm, state: goal.expand(len(palm), 18))
    palm = leader.drawn(windows(begin=0), 1.0).frames.palm
    way = (palm[:, 1:] - palm[:, :-1]) / STEP_M
    wanted = torch.nn.functional.normalize(corner - palm[:, :-1], dim=-1)
    torch.testing.assert_close(way, wanted, atol=1e-3, rtol=0)


def one_meter_a_frame(frames: Frames, rows: torch.Tensor) -> Forecast:
    """Forecasts of targets that are one meter farther in every frame."""
    places = rows[..., None] + torch.tensor(FORECAST_FRAMES)
    places = places[..., None].expand(-1, -1, -1, 3).float()
    features = places.new_zeros(*rows.shape, TINY_OBACT["dim"])
    return Forecast(features, places, places.new_ones(*rows.shape, 1, 1))


# -- losses ----------------------------------------------------------------------------------------


def rolled_out(window: Window, head, first: int, late: int = 0) -> torch.Tensor:
    """The loss of a head in windows whose palms are rolled out from frame ``first`` on."""
    config = SimpleNamespace(embodiment=Embodiment(palm_speed_m_s=0.5), grips=False)
    window = replace(window, delay_frames=late)
    model = SimpleNamespace(config=config, act_once=head)
    b = len(window.begin)
    rows = torch.arange(first, first + FUTURE - late)
    places = torch.zeros(b, len(rows), len(FORECAST_FRAMES), 3)
    forecast = Forecast(torch.zeros(b, len(rows), 1), places, torch.ones(b, len(rows), 1, 1))
    return closed_loop_loss(model, forecast, window, rows.expand(b, -1), teacher()).sum()


@pytest.mark.parametrize("late", [0, 3])
def test_a_palm_is_rolled_out_from_when_the_first_command_takes_effect(late: int):
    """The palm is near the target in that frame alone, and stays where it is."""
    window = windows(1)
    path = torch.arange(200)[None, :, None] * torch.tensor([0.04, 0.0, 0.0])
    full = torch.tensor([200])
    state = torch.full((1, LENGTH, 18), 9.0)
    state[:, 10 + late, :3] = path[:, 10 + late]
    window = replace(
        window,
        targets=Targets(path, full, full, torch.tensor([False])),
        frames=replace(window.frames, state=state),
    )
    still = lambda forecast, palm, state: palm  # noqa: E731
    assert rolled_out(window, still, 10, late=late) < 0.05
    assert rolled_out(window, still, 11, late=late) > 1


def test_a_palm_is_rolled_out_beyond_the_window():
    """A target that waits 50 cm away, which takes a palm 20 frames."""
    window = windows(1)
    path = torch.tensor([0.5, 0.0, 0.0]).expand(1, 200, 3)
    state = torch.zeros(1, LENGTH, 18)
    window = replace(
        window,
        targets=replace(window.targets, path=path, length=torch.tensor([200])),
        frames=replace(window.frames, state=state),
    )
    there = lambda forecast, palm, state: path[:, 0]  # noqa: E731
    assert rolled_out(window, there, LENGTH - 4) < 0.05


def test_the_closed_loop_loss_falls_where_the_head_learns_to_meet_the_target():
    """A head that sends every palm to one place, and a target that waits 12 cm away."""
    window = windows(1)
    goal = torch.zeros(3, requires_grad=True)
    path = torch.tensor([0.1, 0.05, -0.05]).expand(1, 200, 3)
    window = replace(window, targets=replace(window.targets, path=path))
    head = lambda forecast, palm, state: goal.expand(1, 3)  # noqa: E731
    losses = fit([goal], lambda: rolled_out(window, head, PAST - 1), steps=60, rate=0.02)
    assert losses[0] > 1.0
    assert losses[-1] < 0.1


def test_the_closed_loop_teaches_forecast_and_head():
    pull = {}
    for weight in (0.0, 4.0):
        actor = policy(closed_loop_weight=weight)
        losses = window_losses(actor.model, windows(), teacher())
        assert ("closed_loop" in losses) == (weight > 0)
        losses.get("closed_loop", losses["action"] * 0).sum().backward()
        parts = actor.model.head.base, actor.model.when, actor.model.forecaster.bend[-1]
        pull[weight] = [
            0.0 if part.weight.grad is None else float(part.weight.grad.abs().max())
            for part in parts
        ]
    assert max(pull[0.0]) == 0
    assert min(pull[4.0]) > 1e-6


def test_padded_actions_do_not_count():
    actor = policy(forecast_weight=0.0)
    weight = torch.ones(4, 8)
    weight[:, 3:] = 0
    window = replace(windows(4), action_weight=weight)
    actions = window.actions.clone()
    actions[:, 3:] = 9.0
    losses = []
    for one in (window, replace(window, actions=actions)):
        torch.manual_seed(0)
        losses.append(window_losses(actor.model, one, None)["action"])
    torch.testing.assert_close(*losses)


def test_hidden_frames_do_not_count():
    model = policy().model
    hidden = torch.arange(LENGTH).expand(4, LENGTH) < 6
    frames = replace(windows(4).frames, hidden=hidden)
    sightings = frames.sightings.clone()
    sightings[:, :6] = 9.0
    rows = torch.tensor([[PAST - 1, LENGTH - 1]]).expand(4, -1)
    known, other = (
        model.encode_history(one, rows) for one in (frames, replace(frames, sightings=sightings))
    )
    torch.testing.assert_close(other.places, known.places)
    torch.testing.assert_close(other.features, known.features)


def test_a_training_step_mixes_no_devices():
    """Fake tensors need no GPU, and refuse what one would refuse."""
    config = policy().config
    with FakeTensorMode(allow_non_fake_inputs=True), sdpa_kernel(SDPBackend.MATH):
        with torch.device("cuda"):
            model = ObActModel(config)
        losses = window_losses(model, windows().to("cuda"), teacher())
    assert {loss.device.type for loss in losses.values()} == {"cuda"}
