"""N worlds: the same bytes in any batch, limits of the hand, and what is observed from home."""

from dataclasses import replace

import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT, HAND_DOF, PALM_DOF
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.nested import changed
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.env import DynahoiVectorEnv
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.motions.projectile import Lob
from dynahoi_lerobot.motions.straight_line import Constant
from dynahoi_lerobot.rollout.loop import ActionLog, replay
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.world.batch import WorldBatch
from tests.world.playing import SMALL, digest, digests, played, wait, world

SHORTEST = 6


@pytest.fixture(scope="module")
def every_kind(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    return specs[:22]


@pytest.fixture(scope="module")
def reference(expert_episodes: list[Episode]) -> dict[int, str]:
    """Without images: 22 worlds, one thread, in order."""
    return {episode.meta.seed: digest(episode) for episode in expert_episodes[:22]}


@pytest.fixture(scope="module")
def short(specs: list[EpisodeSpec]) -> list[EpisodeSpec]:
    """Of every category, the episodes that are over soonest."""
    chosen: dict[str, EpisodeSpec] = {}
    for spec in sorted(specs, key=lambda s: s.intercept_frame):
        chosen.setdefault(spec.motion.category, spec)
    return list(chosen.values())[:SHORTEST]


@pytest.fixture(scope="module")
def images(short: list[EpisodeSpec]) -> dict[int, str]:
    return digests(short, 1, images=True)


@pytest.mark.parametrize(("step", "size", "threads"), [(1, 3, 2), (-1, 5, 1)])
def test_states_depend_on_no_batch_size_thread_count_neighbor_or_row(
    every_kind, reference, step, size, threads
):
    assert digests(every_kind[::step], size, threads) == reference


def test_pixels_depend_on_no_batch_size_and_no_neighbor(
    short: list[EpisodeSpec], images: dict[int, str]
):
    assert len(set(images.values())) == len(short)
    assert digests(short[::-1], 4, 2, images=True) == images


def test_resetting_one_world_leaves_the_others_untouched(every_kind: list[EpisodeSpec]):
    batch = world(every_kind[:6])
    wait(batch)
    before = batch._batch.state.copy()
    images = batch.cameras.render()
    batch.reset([2], [every_kind[9]])
    others = [0, 1, 3, 4, 5]
    np.testing.assert_array_equal(batch._batch.state[others], before[others])
    np.testing.assert_array_equal(batch.cameras.render()[others], images[others])
    undisturbed = world(every_kind[:6])
    wait(undisturbed)
    for _ in range(5):
        batch.step(batch.executed, np.array(others))
        undisturbed.step(undisturbed.executed)
    np.testing.assert_array_equal(batch._batch.state[others], undisturbed._batch.state[others])


def test_what_struck_a_target_is_not_in_the_way_of_the_next_one(specs: list[EpisodeSpec]):
    struck, striker = next(
        (s, found) for s in specs if (found := s.motion.launch(s.target).striker)
    )
    above = tuple(np.add(striker.pos, (0.0, 0.0, 0.2)))
    fresh = world([falling := replace(struck, motion=Lob(above, (0.0, 0.0, 0.0), release_s=0.0))])
    used = world([struck])
    used.reset([0], [falling])
    for _ in range(12):
        fresh.step(fresh.executed)
        used.step(used.executed)
    np.testing.assert_array_equal(used.target_pose_h, fresh.target_pose_h)


def measured_tips(batch: WorldBatch) -> tuple[np.ndarray, np.ndarray]:
    """Return (5, 3) positions [m] of the fingertips of the first world, home frame, and (5,) their
    distances from its target [m].
    """
    frames = batch.tip_frames(np.arange(1))
    positions = batch.fingertips(0, frames).reshape(5, 6)[:, :3]
    return positions, batch.tip_distance(0, frames)[0]


def test_a_target_at_a_fingertip_is_nearest_to_that_finger(specs: list[EpisodeSpec]):
    batch = world([next(spec for spec in specs if spec.target.name == "ball")])
    tips, _ = measured_tips(batch)
    for finger, tip in enumerate(tips):
        batch.place(batch.state, np.concatenate([tip, [1.0, 0.0, 0.0, 0.0]])[None])
        _, distances = measured_tips(batch)
        assert distances.argmin() == finger


def test_a_fingertip_in_the_middle_of_a_ring_is_as_far_from_it_as_from_its_tube(
    specs: list[EpisodeSpec],
):
    """What lies there are hidden solids, which the ring does not use."""
    spec = next(spec for spec in specs if spec.target.name == "ring")
    batch = world([spec])
    tips, _ = measured_tips(batch)
    batch.place(batch.state, np.concatenate([tips[0], [1.0, 0.0, 0.0, 0.0]])[None])
    segment = spec.target.primitives[0]
    _, distances = measured_tips(batch)
    assert distances[0] == pytest.approx(np.linalg.norm(segment.pos) - segment.size[0], abs=1e-6)


SHIFT_W = np.array([0.5, -0.25, 0.125])
ROUNDING = 2e-6
"""Of positions up to 3 m in single precision [m]."""


def shifted(spec: EpisodeSpec) -> EpisodeSpec:
    """The episode of a target in straight motion with everything in it elsewhere in the world."""
    assert isinstance(spec.motion, Constant)
    return replace(
        spec,
        motion=replace(
            spec.motion, meeting=tuple((np.asarray(spec.motion.meeting) + SHIFT_W).tolist())
        ),
        home_pos_w=spec.home_pos_w + SHIFT_W,
        intercept_pos_w=spec.intercept_pos_w + SHIFT_W,
        target_path_w=spec.target_path_w + SHIFT_W,
    )


def test_an_episode_elsewhere_looks_the_same_in_numbers(specs: list[EpisodeSpec]):
    here = next(spec for spec in specs if spec.motion.name == "constant")
    one = world([here])
    other = world([shifted(here)])
    rng = np.random.default_rng(3)
    while not one.localized[0] and one.frame[0] < here.window_frames + 12:
        command = np.concatenate(
            [rng.uniform(-0.3, 0.3, PALM_DOF), rng.uniform(0, 1, HAND_DOF - PALM_DOF)]
        )[None]
        for batch in (one, other):
            batch.step(command)
        for name in ("state", "given", "target_pose_h", "target_velocity_w", "palm_distance_m"):
            np.testing.assert_allclose(
                getattr(one, name), getattr(other, name), atol=ROUNDING, err_msg=name
            )
        np.testing.assert_allclose(measured_tips(one)[0], measured_tips(other)[0], atol=5e-6)
    np.testing.assert_allclose(other.home_pos_w - one.home_pos_w, SHIFT_W[None], atol=1e-12)


def test_an_episode_keeps_its_home_apart(expert_episodes: list[Episode], specs: list[EpisodeSpec]):
    for episode, spec in zip(expert_episodes, specs, strict=True):
        np.testing.assert_array_equal(
            episode.home_pos_w, spec.home_pos_w
        )  # exactly, in single precision
        intercept_w = episode.intercept_pos_h + episode.home_pos_w
        np.testing.assert_allclose(intercept_w, spec.intercept_pos_w, atol=ROUNDING)
        assert not episode.state[0, :PALM_DOF].any()


@pytest.mark.parametrize("control_class", ["standard", "late"])
def test_stored_actions_replay_to_the_bit(control_class: str, specs: list[EpisodeSpec]):
    """Over whole episodes with commands beyond every limit: those of the slides lie elsewhere in
    each home frame.
    """
    recipe = changed(SMALL, {"control_class": control_class})
    for spec in specs[2:20:6]:
        rng = np.random.default_rng(spec.seed)
        commands = rng.normal(0, [1.5] * PALM_DOF + [1.0] * (HAND_DOF - PALM_DOF), (40, HAND_DOF))
        (first,) = replay(
            recipe, [ActionLog(spec.seed, np.repeat(commands, 2, axis=0)[:60])], images=False
        )
        (again,) = replay(recipe, [ActionLog(spec.seed, first.action)], images=False)
        for name in ("state", "action", "executed_action", "fingertips", "target_pose_h"):
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name), err_msg=name)


SEEING = Recipe.of(split="test", image_size=16, views=("side",))
BLIND = changed(SEEING, {"protocol": "observe_then_blind"})


def filmed(recipe: Recipe, count: int = 4) -> list[Episode]:
    specs = sample_specs(recipe, range(count))
    return played(recipe.rules, EXPERTS["intercept"](), specs, images=True)


@pytest.fixture(scope="module")
def seen() -> list[Episode]:
    return filmed(SEEING)


def test_the_cameras_see_the_window_and_nothing_after_it(seen: list[Episode]):
    for seeing, blind in zip(seen, filmed(BLIND), strict=True):
        assert blind.success
        np.testing.assert_array_equal(blind.state, seeing.state)
        window = blind.meta.window_frames
        for view in ("ego", "side"):
            np.testing.assert_array_equal(blind.images[view][:window], seeing.images[view][:window])
            assert seeing.images[view][window:].any(axis=(1, 2, 3)).all()
            assert not blind.images[view][window:].any()


def test_render_noise_changes_every_image_by_up_to_the_given_levels_and_nothing_else(
    seen: list[Episode],
):
    for clean, noisy in zip(seen, filmed(changed(SEEING, {"render_noise": 2})), strict=True):
        np.testing.assert_array_equal(noisy.state, clean.state)
        for view in ("ego", "side"):
            change = noisy.images[view].astype(int) - clean.images[view]
            within = change[(clean.images[view] > 2) & (clean.images[view] < 253)]
            assert set(np.unique(within)) == {-2, -1, 0, 1, 2}
            assert abs(within.mean()) < 0.1
            assert (change != 0).any(axis=(1, 2, 3)).all()
            assert not np.array_equal(change[0], change[1])
    (blind,) = filmed(changed(BLIND, {"render_noise": 2}), 1)
    assert not blind.images["ego"][blind.meta.window_frames :].any(), "black images stay black"


ARRIVAL_PALM_M, ARRIVAL_JOINT_RAD = 0.001, 0.015
"""How close a joint is at the end of the frame, at 1 m/s and 10 rad/s; links pull at each other a
little."""


@pytest.fixture
def hands(specs: list[EpisodeSpec]) -> WorldBatch:
    """Four worlds in the control phase."""
    batch = world(specs[:4], control_class="unlimited")
    wait(batch)
    return batch


def test_every_joint_arrives_at_its_command_at_the_end_of_the_frame(hands: WorldBatch):
    rng = np.random.default_rng(1)
    for _ in range(30):
        step = np.hstack(
            [
                rng.uniform(-0.05, 0.05, (4, PALM_DOF)),
                rng.uniform(-0.5, 0.5, (4, HAND_DOF - PALM_DOF)),
            ]
        )
        wanted = np.clip(hands.executed + step, *hands.commands.limits())
        hands.step(wanted)
        np.testing.assert_array_equal(hands.given, wanted.astype(np.float32))
        error = np.abs(hands.state - wanted)
        assert error[:, :PALM_DOF].max() < ARRIVAL_PALM_M
        assert error[:, PALM_DOF:].max() < ARRIVAL_JOINT_RAD


def waiting(specs: list[EpisodeSpec], **options) -> WorldBatch:
    """Four worlds whose next command is the first of the control phase, or takes effect then."""
    batch = world(specs[:4], **options)
    while not batch.accepting.all():
        batch.step(batch.executed)
    return batch


@pytest.mark.parametrize("control_class", CONTROL_CLASSES)
def test_palm_and_joints_keep_to_the_speed_limits_and_the_palm_to_its_direction(
    control_class: str, specs
):
    hands = waiting(specs, control_class=control_class)
    control = CONTROL_CLASSES[control_class]
    direction = np.array([3.0, -2.0, 6.0]) / 7
    late = control.latency_frames > 0
    assert hands.acting.all() != late, "the window goes on until the first command takes effect"
    before = hands.executed.copy()
    for _ in range(1 + control.latency_frames):
        hands.step(
            np.hstack(
                [before[:, :PALM_DOF] + 5 * direction * [0.2, 0.2, 0.2], before[:, PALM_DOF:] + 2.0]
            )
        )
    moved = hands.executed - before
    np.testing.assert_allclose(
        moved[:, :PALM_DOF],
        np.tile(control.palm_speed_m_s * CONTROL_DT * direction, (4, 1)),
        rtol=1e-5,
    )
    np.testing.assert_allclose(
        moved[:, PALM_DOF:].max(axis=1), control.joint_speed_rad_s * CONTROL_DT, rtol=1e-5
    )


def test_under_contact_each_axis_of_the_gantry_has_its_limit(specs: list[EpisodeSpec]):
    hands = waiting(specs, capture="contact", hand="opposed")
    before = hands.executed.copy()
    hands.step(before + ([1.0, -1.0, 0.01] + [0.0] * 15))
    np.testing.assert_allclose(
        hands.executed - before, np.tile([0.1, -0.1, 0.01] + [0.0] * 15, (4, 1)), atol=1e-6
    )


def test_commands_beyond_the_range_end_at_its_limit_in_an_action_space_that_does_not_tell_the_home(
    hands: WorldBatch,
):
    env = DynahoiVectorEnv(4, split="test", image_size=0)
    low = env.single_action_space.low
    high = env.single_action_space.high
    np.testing.assert_array_equal(low[:PALM_DOF], -high[:PALM_DOF])
    for seed in (0, 4):
        env.reset(seed=seed)
        np.testing.assert_array_equal(
            (env.single_action_space.low, env.single_action_space.high), (low, high)
        )
    for side, limit in ((-1.0, hands.commands.low), (1.0, hands.commands.high)):
        for _ in range(120):
            hands.step(np.full((4, HAND_DOF), side * 50.0))
        reached = hands.executed + np.hstack([hands.home_pos_w, np.zeros((4, HAND_DOF - PALM_DOF))])
        np.testing.assert_allclose(reached, np.tile(limit, (4, 1)), atol=1e-6)
        np.testing.assert_allclose(hands.state, hands.executed, atol=0.01)
        assert (hands.given >= low).all()
        assert (hands.given <= high).all()


def of_world_2(command: float) -> np.ndarray:
    """Commands of four worlds, all of them zero but one."""
    commands = np.zeros((4, HAND_DOF))
    commands[2, 7] = command
    return commands


@pytest.mark.parametrize(
    ("commands", "named"),
    [
        (of_world_2(np.nan), "world 2 must be finite"),
        (of_world_2(-np.inf), "world 2 must be finite"),
        (np.zeros((3, HAND_DOF)), "shape"),
        (np.zeros((4, HAND_DOF - 1)), "shape"),
        (np.zeros((4, HAND_DOF, 1)), "shape"),
    ],
)
def test_commands_that_are_not_finite_or_of_another_shape_move_nothing(commands, named, specs):
    batch = world(specs[:4])
    before = batch._batch.state.copy()
    with pytest.raises(ValueError, match=named):
        batch.step(commands)
    np.testing.assert_array_equal(batch._batch.state, before)
    assert not batch.frame.any()


def test_in_the_window_which_the_phase_tells_commands_are_ignored_and_the_hand_holds_still(
    specs: list[EpisodeSpec],
):
    batch = world(specs[:8])
    rng = np.random.default_rng(0)
    for frame in range(12):
        in_window = np.array([frame < spec.window_frames for spec in specs[:8]])
        np.testing.assert_array_equal(
            batch.observe(images=False).phase, np.column_stack([in_window, ~in_window])
        )
        np.testing.assert_allclose(batch.state[in_window], 0.0, atol=1e-4)
        assert not batch.localized[in_window].any()
        batch.step(rng.normal(size=(8, HAND_DOF)))
    assert not in_window.all(), "some windows are over"
