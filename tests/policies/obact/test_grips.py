"""Learning to catch by contact: virtual hands catch, what is in the hand goes with it, labels are the expert's."""

import pytest
import torch
from lerobot_policy_obact.grips import SEAT, GrippingHands, grip_answers, grip_palms
from lerobot_policy_obact.recordings import Targets

from dynahoi_lerobot.core.agent import WorldState
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.experts.base import Teacher
from dynahoi_lerobot.experts.match import HELD_M, STEP_M
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

WINDOW, FRAMES, HORIZON = 10, 90, 4


def passing_targets(n: int) -> Targets:
    """Targets that pass in front of the hand at up to 0.5 m/s, in straight lines."""
    start = torch.tensor([0.3, 0.0, 0.0]) + 0.1 * torch.randn(n, 1, 3)
    path = start + torch.arange(FRAMES)[:, None] * 0.015 * torch.rand(n, 1, 3)
    full = torch.full((n,), FRAMES)
    return Targets(path, full, full, open_joints=torch.zeros(15), closed_joints=torch.full((15,), 1.3))


@pytest.fixture(scope="module")
def played() -> tuple[Targets, torch.Tensor]:
    """Targets after virtual hands went for them, and where the palms were, ``(B, T, 3)``."""
    torch.manual_seed(0)
    hands, palms = GrippingHands(passing_targets(64), torch.full((64,), WINDOW), step_m=0.1), []
    for t in range(FRAMES):
        palms.append(hands.palm)
        hands.move(t)
    return hands.targets, torch.stack(palms, dim=1)


def test_virtual_hands_wait_catch_and_carry_the_target_along(played: tuple[Targets, torch.Tensor]):
    targets, palm = played
    assert (palm[:, : WINDOW + 1] == 0).all()
    caught = (targets.contact < FRAMES).nonzero()[:, 0]
    assert len(caught) >= 0.9 * len(palm)
    for i in caught:
        contact = int(targets.contact[i])
        assert targets.carried[i, :contact].equal(targets.path[i, :contact])
        offset = palm[i, contact:] - (targets.carried[i, contact:] - SEAT)
        assert offset[0].norm() < HELD_M + STEP_M
        assert (offset - offset[0]).abs().max() < 1e-5
        assert palm[i, -1, 2] > palm[i, contact, 2], "it is lifted"


def test_a_target_in_the_hand_is_expected_to_go_with_it_and_one_before_the_catch_to_go_on(played):
    targets, _ = played
    caught = targets.of((targets.contact < FRAMES - 10).nonzero()[:4, 0])
    due = torch.stack([caught.contact - 1, caught.contact], dim=1)
    places = caught.places(due[..., None] + torch.tensor([0, 8]), due)
    rows, ahead = torch.arange(len(due)), caught.contact + 8
    assert places[:, 0, 1].equal(caught.path[rows, ahead - 1])
    assert places[:, 1, 1].equal(caught.carried[rows, ahead])


def test_palms_that_hold_a_target_stay_closed_and_are_not_moved(played: tuple[Targets, torch.Tensor]):
    targets, palm = played
    caught = (targets.contact < FRAMES - 2 * HORIZON).nonzero()[:, 0]
    targets, due = targets.of(caught), targets.contact[caught][:, None] + 2
    held = palm[caught[:, None], due]
    palms = grip_palms(targets, due, held)
    assert palms.equal(held[:, :, None].expand_as(palms))
    goals, closing, _ = grip_answers(targets, due, palms, HORIZON)
    assert (closing == 1).all()
    later = palm[caught[:, None], due + HORIZON]
    torch.testing.assert_close(goals[:, :, 0, -1], later, atol=1e-4, rtol=0)


def test_labels_are_what_the_expert_commands():
    recipe = Recipe(split="train", capture="contact", image_size=0)
    specs, expert = sample_specs(recipe, range(4)), EXPERTS["match"]()
    batch = WorldBatch(recipe, len(specs))
    batch.reset(range(len(specs)), specs)
    for _ in range(max(spec.window_frames for spec in specs) + 2):
        world: WorldState = batch.world_state(batch.observe(images=False))
        assert isinstance(expert, Teacher)
        commands = expert.goals(world)
        for i, spec in enumerate(specs):
            if world.frame[i] > spec.window_frames + 2:
                continue  # it may hold the target by then
            path = torch.tensor(spec.oracle_path - spec.home_pos_w, dtype=torch.float32)[None]
            length = torch.tensor([path.shape[1]])
            targets = Targets(path, length, length, torch.zeros(15), torch.ones(15))
            due = torch.tensor([[max(int(world.frame[i]), spec.window_frames)]])
            palm = torch.tensor(world.state_when_due[i, :3], dtype=torch.float32).reshape(1, 1, 1, 3)
            goals, closing, _ = grip_answers(targets, due, palm, HORIZON)
            torch.testing.assert_close(goals[0, 0, 0, 0], torch.tensor(commands[i, :3]).float(), atol=1e-5, rtol=0)
            assert bool(closing[0, 0, 0, 0]) == (commands[i, 3:].mean() > 0.5)
        batch.step(commands)
