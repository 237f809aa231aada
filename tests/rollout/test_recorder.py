"""What an episode stores of cameras, object and plan is what the simulator has."""

import mujoco
import numpy as np
import pytest

from dynahoi_lerobot.core.conventions import CONTROL_DT, EGO_VIEW
from dynahoi_lerobot.core.episode import Episode
from dynahoi_lerobot.core.protocols import CONTROL_CLASSES
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.objects.primitives import from_table
from dynahoi_lerobot.rollout.recorder import episode_constants
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.scene.model import SIDE_CAMERA
from dynahoi_lerobot.scene.pinhole import Pinhole
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.world.batch import WorldBatch

POSITION_ERROR_M = 1e-12
"""Positions of the simulator are in float64."""


def moved(hand: str, home_w: np.ndarray, palm_w: np.ndarray, joints: np.ndarray) -> mujoco.MjData:
    """The scene with a hand elsewhere than at home."""
    scene = compile_scene(hand)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = np.concatenate([palm_w, joints])
    data.mocap_pos[scene.side_mocap] = home_w
    mujoco.mj_kinematics(scene.model, data)
    mujoco.mj_camlight(scene.model, data)
    return data


@pytest.mark.parametrize("hand", HANDS.names())
@pytest.mark.parametrize(("camera", "carried"), [(EGO_VIEW, True), (SIDE_CAMERA, False)])
def test_camera_poses_follow_from_the_palm_by_a_fixed_transform(
    hand: str, camera: str, carried: bool
):
    rng = np.random.default_rng(3)
    model = compile_scene(hand).model
    pinhole = Pinhole.of(model, camera)
    for _ in range(5):
        home, palm = rng.uniform([-1, -1, 0.5], [1, 1, 1.5], (2, 3))
        data = moved(hand, home, palm, rng.uniform(0, 1, 15))
        found = data.camera(camera)
        np.testing.assert_allclose(
            found.xpos, (palm if carried else home) + pinhole.pos_m, atol=POSITION_ERROR_M
        )
        np.testing.assert_allclose(found.xmat.reshape(3, 3), pinhole.axes, atol=POSITION_ERROR_M)


def test_a_camera_sees_places_where_its_intrinsics_say():
    camera = Pinhole.of(compile_scene("capsule").model, EGO_VIEW)
    ray = np.random.default_rng(0).uniform([-0.2, -0.2, -1.0], [0.2, 0.2, -0.3], (5, 3))
    right, up, depth_m = camera.project(ray @ camera.axes.T).T
    fx, fy, cx, cy = camera.intrinsics(96)
    np.testing.assert_allclose(depth_m, -ray[:, 2])
    np.testing.assert_allclose(48 * (1 + right), cx + fx * ray[:, 0] / depth_m)
    np.testing.assert_allclose(48 * (1 - up), cy - fy * ray[:, 1] / depth_m)


def test_the_object_is_the_one_that_is_simulated(specs: list[EpisodeSpec]):
    batch = WorldBatch(Rules(), len(specs))
    batch.reset(range(len(specs)), specs)
    fields = batch._fields.fields
    scene = batch.scene
    for i, spec in enumerate(specs):
        kept = episode_constants(batch, spec, None)
        assert kept["object_mass_kg"] == fields["body_mass"][i, scene.target_body]
        np.testing.assert_array_equal(
            kept["object_inertia"], fields["body_inertia"][i, scene.target_body]
        )
        hand, *surfaces = (
            fields["geom_friction"][i, list(geoms), 0].max()
            for geoms in (scene.hand_geoms, scene.target_geoms, scene.box_geoms)
        )
        assert kept["object_friction"] == [hand, max(surfaces)], spec.motion.name
        for solid, geom in zip(
            from_table(kept["object_primitives"]), scene.slots_of(spec.target), strict=True
        ):
            np.testing.assert_allclose(
                fields["geom_size"][i, geom], solid.half_size, rtol=1e-6, atol=1e-9
            )
            np.testing.assert_allclose(fields["geom_pos"][i, geom], solid.pos, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("control", CONTROL_CLASSES.values(), ids=lambda control: control.name)
def test_the_hand_does_what_the_expert_planned_first(in_class, control):
    """The palm leaves home at the planned speed, and has the target when the lead time is over."""
    for episode in in_class(control.name)[:22]:
        speed, lead_s = episode.first_plan
        start = episode.meta.window_frames
        assert speed <= min(control.palm_speed_m_s, 1.0) + 1e-6
        assert lead_s == pytest.approx(round(lead_s / CONTROL_DT) * CONTROL_DT)
        first = episode.first_localized
        assert first - start <= round(lead_s / CONTROL_DT)
        if first > start + 2:
            left = (
                np.linalg.norm(episode.palm_pos_h[start + 2] - episode.palm_pos_h[start + 1])
                / CONTROL_DT
            )
            assert left == pytest.approx(speed, abs=0.02), episode.meta.motion


def test_the_target_path_is_where_the_target_is_until_it_is_touched(
    expert_episodes, contact_episodes
):
    for episode in [*expert_episodes[:22], *contact_episodes]:
        meta = episode.meta
        path = episode.target_path_h
        assert len(path) == meta.window_frames + meta.length_frames + 1 >= len(episode)
        near = episode.localized if meta.capture == "attach" else episode.palm_distance_m < 0.2
        untouched = max(int(np.append(near, True).argmax()), 1)
        apart = path[:untouched] - episode.target_pose_h[:untouched, :3]
        assert np.abs(apart).max() < 1e-4, meta.motion


def test_a_catch_by_contact_is_planned_where_the_palm_gets_to_the_target(
    contact_episodes: list[Episode],
):
    for episode in contact_episodes:
        planned = episode.meta.window_frames + round(float(episode.first_plan[1]) / CONTROL_DT)
        assert abs(episode.first_localized - planned) <= 2, episode.meta.motion
