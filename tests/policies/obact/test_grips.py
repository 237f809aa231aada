"""The teacher of the contact track: hands that follow it catch, held targets go with them, it
answers as the expert.
"""

from dataclasses import replace

import torch
from lerobot_policy_obact.belief import stepped
from lerobot_policy_obact.recordings import GRIP_M
from lerobot_policy_obact.teacher import NEVER, Grip, Targets

from dynahoi_lerobot.core.agent import WorldState
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch

WINDOW, FRAMES, HORIZON = 10, 90, 4


def passing_targets(n: int) -> Targets:
    """Targets that pass in front of the hand at up to 0.5 m/s, in straight lines."""
    start = torch.tensor([0.3, 0.0, 0.0]) + 0.1 * torch.randn(n, 1, 3)
    path = start + torch.arange(FRAMES)[:, None] * 0.015 * torch.rand(n, 1, 3)
    full = torch.full((n,), FRAMES)
    return Targets(path, full, full, path, torch.full((n,), NEVER))


def grip(fps: float = 20.0) -> Grip:
    return Grip(fps, 0.1, torch.zeros(15), torch.full((15,), 1.3), GRIP_M)


def test_a_hand_that_follows_it_closes_where_it_has_the_target():
    torch.manual_seed(0)
    targets, palm, caught = (
        passing_targets(64),
        torch.zeros(64, 3),
        torch.zeros(64, dtype=torch.bool),
    )
    for t in range(WINDOW, FRAMES - 1):
        told = grip().answer(targets, torch.full((64, 1), t), palm[:, None, None], 1)
        moved = stepped(palm, told.goal[:, 0, 0, 0], 0.1)
        caught |= grip().caught(targets, t, palm, moved, told.closing[:, 0, 0, 0] > 0.5)
        palm = moved
    assert caught.float().mean() >= 0.9


def carried_targets() -> Targets:
    """Targets that are held from frame 30 on by hands that go upwards at 0.2 m/s."""
    targets = passing_targets(4)
    carried = targets.path.clone()
    carried[:, 30:] = carried[:, 29:30] + torch.arange(1, FRAMES - 29)[:, None] * torch.tensor(
        [0, 0, 0.01]
    )
    return replace(targets, carried=carried, held=torch.full((4,), 30))


def test_a_target_in_the_hand_is_expected_to_go_with_it_and_one_before_the_catch_to_go_on():
    targets = carried_targets()
    due = torch.tensor([[29, 30]]).expand(4, -1)
    places = targets.places(due[..., None] + torch.tensor([0, 8]), due)
    assert places[:, 0, 1].equal(targets.path[:, 37])
    assert places[:, 1, 1].equal(targets.carried[:, 38])


def test_a_hand_that_holds_a_target_stays_closed_is_not_moved_and_slows_to_lifting():
    targets, due = carried_targets(), torch.full((4, 1), 40)
    held = targets.carried[:, 40] - grip().seat
    palms = grip().palms(targets, due, held[:, None])
    assert palms.equal(held[:, None, None].expand_as(palms))
    told = grip().answer(targets, due, palms, HORIZON)
    assert (told.closing == 1).all()
    speed = (told.goal[:, 0, 0].diff(dim=1)[..., 2] / 0.05).mean(0)
    assert (speed.diff() < 0).all()
    assert 0.15 < speed[-1] < speed[0] < 0.2


def test_labels_are_what_the_expert_commands():
    recipe = Recipe.of(split="train", capture="contact", image_size=0)
    specs, expert = sample_specs(recipe, range(4)), EXPERTS["match"]()
    batch = WorldBatch(recipe.rules, len(specs))
    batch.reset(range(len(specs)), specs)
    for _ in range(max(spec.window_frames for spec in specs) + 2):
        world: WorldState = batch.world_state(batch.observe(images=False))
        commands = expert.label(world)
        for i, spec in enumerate(specs):
            if world.frame[i] > spec.window_frames + 2:
                continue  # it may hold the target by then
            path = torch.tensor(spec.target_path_w - spec.home_pos_w, dtype=torch.float32)[None]
            length = torch.tensor([path.shape[1]])
            targets = Targets(path, length, length, path, torch.tensor([NEVER]))
            due = torch.tensor([[max(int(world.frame[i]), spec.window_frames)]])
            palm = torch.tensor(world.state_when_due[i, :3], dtype=torch.float32).reshape(
                1, 1, 1, 3
            )
            told = grip().answer(targets, due, palm, HORIZON)
            torch.testing.assert_close(
                told.goal[0, 0, 0, 0], torch.tensor(commands[i, :3]).float(), atol=1e-5, rtol=0
            )
            assert bool(told.closing[0, 0, 0, 0]) == (commands[i, 3:].mean() > 0.5)
        batch.step(commands)
