"""The robot hand from MuJoCo Menagerie stands where the bundled ones stand, and catches what they catch."""

import mujoco
import numpy as np

from dynahoi_lerobot.cli import main as cli
from dynahoi_lerobot.core.conventions import FINGERS, HAND_NAMES
from dynahoi_lerobot.experts import EXPERTS
from dynahoi_lerobot.hands.sharpa import MENAGERIE_ROOT, menagerie_model_path
from dynahoi_lerobot.rollout.loop import evaluate
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_specs
from dynahoi_lerobot.scene import scene
from dynahoi_lerobot.scene.scene import compile_scene
from dynahoi_lerobot.world.batch import WorldBatch
from tests.menagerie import ARMATURE, TORQUE_NM

RECIPE = Recipe(split="test", hand="sharpa", image_size=32)


def test_it_has_the_eighteen_joints_and_its_own_limits() -> None:
    model = compile_scene("sharpa").model
    joints = [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)]
    assert tuple(joints) == HAND_NAMES
    assert (model.actuator_forcerange[3:] == [-TORQUE_NM, TORQUE_NM]).all()
    dofs = model.jnt_dofadr[model.actuator_trnid[3:, 0]]
    assert (model.dof_armature[dofs] == ARMATURE).all()
    source = mujoco.MjModel.from_xml_path(str(menagerie_model_path()))
    assert source.njnt == 22
    for i in range(model.nu)[3:]:
        low, high = model.jnt_range[model.actuator_trnid[i, 0]]
        assert low <= -0.05 < 1.0 < high, f"positive angles of {joints[i]} close"


def test_open_it_is_the_models_own_pose() -> None:
    """Fingertips lie in the palm's frame where the model at zero has them in the wrist's."""
    source = mujoco.MjModel.from_xml_path(str(menagerie_model_path()))
    theirs = mujoco.MjData(source)
    mujoco.mj_kinematics(source, theirs)
    model = compile_scene("sharpa").model
    ours = mujoco.MjData(model)
    mujoco.mj_kinematics(model, ours)
    for finger in FINGERS:
        x, y, z = theirs.site(f"left_{'pinky' if finger == 'little' else finger}_fingertip").xpos
        offset = ours.site(f"{finger}_tip").xpos - ours.site("palm_center").xpos
        np.testing.assert_allclose(offset, [x - 0.046, z - 0.0835, -y], atol=1e-6)


def test_the_expert_catches_every_kind_with_it_and_policies_see_the_same() -> None:
    bundled = WorldBatch(Recipe(split="test", image_size=32), 22)
    batch = WorldBatch(RECIPE, 22)
    episodes = list(evaluate(batch, EXPERTS["intercept"](), sample_specs(RECIPE, range(22))))
    assert [episode.stage for episode in episodes] == ["captured"] * 22
    for name in ("state", "phase"):
        one, other = (getattr(b.observe(images=False), name) for b in (batch, bundled))
        assert (one.shape, one.dtype) == (other.shape, other.dtype)


def test_it_is_seen() -> None:
    batch = WorldBatch(RECIPE, 1)
    batch.reset([0], sample_specs(RECIPE, [0]))
    shown = batch.cameras.segmentation()
    assert np.isin(shown, batch.scene.hand_geoms).mean() > 0.03
    assert len(np.unique(shown[np.isin(shown, batch.scene.hand_geoms)])) > 5


def test_without_menagerie_one_sentence_says_what_to_do(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(MENAGERIE_ROOT, str(tmp_path))
    scene._compile.cache_clear()
    words = ["--policy", "hold", "--hand", "sharpa", "--split", "test_small", "--episodes", "1"]
    assert cli.main(["evaluate", *words]) == 2
    message = capsys.readouterr().err
    assert f"{tmp_path} holds no sharpa_wave/left_hand.xml" in message
    assert "MENAGERIE_ROOT" in message
