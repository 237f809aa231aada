"""What a LeRobot user would write without this project: a loop over ``mj_step``, one world.

It plays the same episodes in the same scene with the same expert, and nothing in it is slow on
purpose: shadows and multisampling, which cost MuJoCo's renderer much, are off unless asked for, the
frame buffer has the size of the image, the model is compiled once and every episode is written into
it, and the recorder leaves out the columns that take extra work (contacts, captures).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces

from dynahoi_lerobot.core.agent import WorldView
from dynahoi_lerobot.core.conventions import (
    CONTROL_HZ,
    FINGER_DOF,
    LOCALIZATION_RADIUS_M,
    PALM_DOF,
    SUBSTEPS,
)
from dynahoi_lerobot.core.episode import in_reference_grasp
from dynahoi_lerobot.core.features import CAMERA_KEY, FEATURES, frame_features, image_feature
from dynahoi_lerobot.core.protocols import one_hot_phase
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.dataset.video import Encoding
from dynahoi_lerobot.env.vector_env import observation_space
from dynahoi_lerobot.experts.intercept import Intercept
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.sampler import sample_spec
from dynahoi_lerobot.scene.world_fields import drive_for
from dynahoi_lerobot.world.batch import WorldBatch

SETTLE_FRAMES = 10
STATE = FEATURES["state"].key
PHASE = FEATURES["phase"].key
ACTION = FEATURES["action"].key


class StraightforwardEnv(gym.Env):
    """One hand and one object in plain MuJoCo; observations, actions and endings are those of
    ``DynahoiEnv``.
    """

    def __init__(
        self, image_size: int = 128, split: str = "test", *, shadows: bool = False
    ) -> None:
        """Compile the model; with ``shadows`` it is drawn as MuJoCo draws by default, multisampled
        and with shadows.
        """
        self.recipe = Recipe.of(split=split, image_size=image_size)
        self._shadows = shadows
        self._writer = WorldBatch(Rules(), 1, threads=1)  # writes an episode's numbers into a model
        self._scene = self._writer.scene
        self._commands = self._writer.commands
        self._limits_w = np.stack([self._commands.low, self._commands.high])
        self.model = self._writer._batch.get_model(0)
        self.data = mujoco.MjData(self.model)
        self._renderer: mujoco.Renderer | None = None  # opened by the first image
        self.observation_space = observation_space(frame_features(image_size))
        self.action_space = spaces.Box(*self._commands.limits(), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict, dict]:
        super().reset(seed=seed)
        number = int(self.np_random.integers(0, 2**31)) if seed is None else seed
        return self.begin(sample_spec(self.recipe, number)), {"is_success": False}

    def begin(self, spec: EpisodeSpec) -> dict:
        """Put the world into the first frame of ``spec``."""
        self.episode = spec
        self.frame = 0
        self.localized_frame = None
        self.success = False
        self._writer.reset([0], [spec])
        self._writer._batch.get_model(0, self.model)
        self._writer._batch.get_data(0, self.data)
        mujoco.mj_forward(self.model, self.data)
        self._force = drive_for(spec.motion, spec.target, spec.horizon_frames)[2]
        self.origin_w = np.concatenate([spec.home_pos_w, np.zeros(FINGER_DOF)])
        self.executed = np.concatenate([np.zeros(PALM_DOF), spec.open_joints])
        return self._observe()

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        acting = self.frame >= self.episode.window_frames
        before = self.executed
        if acting:
            given = np.asarray(action, float)[None]
            reach = (self._limits_w - self.origin_w)[:, None]
            self.executed = self._commands.within_reach(given, before[None], *reach)[0]
        (set_points,) = self._commands.set_points(self.executed[None], before[None])
        self._simulate(set_points + self.origin_w, acting)
        self.frame += 1
        mujoco.mj_forward(self.model, self.data)
        settled = (
            self.localized_frame is not None and self.frame - self.localized_frame > SETTLE_FRAMES
        )
        late = self.frame > self.episode.window_frames + self.episode.length_frames
        reward = float(self.success and (settled or late))
        return self._observe(), reward, settled, late and not settled, {"is_success": self.success}

    def _simulate(self, set_points: np.ndarray, acting: bool) -> None:
        """Advance by one frame; a target that comes near while the hand is ``acting`` is caught."""
        target = slice(self._scene.target_dof, self._scene.target_dof + 3)
        for substep in range(SUBSTEPS):
            self.data.ctrl[:] = set_points[substep]
            free = self.localized_frame is not None or self.frame >= len(self._force)
            self.data.qfrc_applied[target] = 0.0 if free else self._force[self.frame][substep]
            mujoco.mj_step(self.model, self.data)
            if acting and self.localized_frame is None and self._distance() < LOCALIZATION_RADIUS_M:
                self._attach()

    def render(self) -> np.ndarray:
        size = self.recipe.rules.image_size
        renderer = self._renderer
        if renderer is None:
            self.model.vis.quality.offsamples = 4 if self._shadows else 0
            self.model.vis.global_.offwidth = self.model.vis.global_.offheight = size
            renderer = self._renderer = mujoco.Renderer(self.model, size, size)
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW.value] = self._shadows
        renderer.update_scene(self.data, self._scene.camera)
        return renderer.render()

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()

    def view(self) -> WorldView:
        """Return what the expert sees, in the world frame."""
        pose, velocity = self.target_state()
        return WorldView(
            self.episode,
            self.executed + self.origin_w,
            self.frame,
            max(self.frame, self.episode.window_frames),
            pose[:3] + self.episode.home_pos_w,
            velocity[:3],
            self.localized_frame is not None,
            self._writer.control,
            LOCALIZATION_RADIUS_M,
        )

    def target_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (7,), home frame, and velocity (6,) of the target."""
        qpos = self._scene.target_qpos
        dof = self._scene.target_dof
        pose = self.data.qpos[qpos : qpos + 7].copy()
        pose[:3] -= self.episode.home_pos_w
        return pose, self.data.qvel[dof : dof + 6].copy()

    def _observe(self) -> dict:
        images = {"pixels": {"ego": self.render()}} if self.recipe.rules.image_size else {}
        return images | {
            "agent_pos": (self.data.qpos[self._scene.hand_qpos] - self.origin_w).astype(np.float32),
            "phase": one_hot_phase(np.array(self.frame >= self.episode.window_frames)),
        }

    def _distance(self) -> float:
        qpos = self._scene.target_qpos
        gap = self.data.qpos[qpos : qpos + 3] - self.data.qpos[self._scene.hand_qpos[:PALM_DOF]]
        return float(np.linalg.norm(gap))

    def _attach(self) -> None:
        """Weld the target to the palm and judge the grasp."""
        scene = self._scene
        data = self.data
        model = self.model
        self.localized_frame = self.frame
        palm, joints = np.split(data.qpos[scene.hand_qpos] - self.origin_w, [PALM_DOF])
        self.success = bool(
            in_reference_grasp(joints, self.episode.open_joints, self.episode.reference_joints)
        )
        model.geom_contype[scene.target_geoms] = 0
        position, quat = np.split(self.target_state()[0], [3])
        inverse = np.zeros(4)
        offset = np.zeros(3)
        mujoco.mju_negQuat(inverse, quat)
        mujoco.mju_rotVecQuat(offset, palm - position, inverse)
        model.eq_data[scene.weld_eq, :11] = [0, 0, 0, *offset, *inverse, 1.0]
        data.eq_active[[scene.tether_eq, scene.weld_eq]] = 0, 1
        dof = scene.target_dof
        data.qvel[dof : dof + 6] = [*data.qvel[scene.hand_dof[:PALM_DOF]], 0, 0, 0]


def record(root: Path, recipe: Recipe, seeds: Sequence[int], *, shadows: bool = False) -> int:
    """Record the expert's successes with LeRobot's streaming writer, coded as this project codes;
    return the frames.
    """
    from lerobot.configs.video import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    env = StraightforwardEnv(recipe.rules.image_size, recipe.split, shadows=shadows)
    encoding = Encoding()
    dataset = LeRobotDataset.create(
        "local/straightforward",
        CONTROL_HZ,
        _features(recipe.rules.image_size),
        root,
        rgb_encoder=RGBEncoderConfig(
            encoding.codec, crf=encoding.crf, preset=encoding.preset, g=encoding.gop, fast_decode=1
        ),
        streaming_encoding=True,
        # frames come faster than real time; a full queue would drop some
        encoder_queue_maxsize=1000,
        encoder_threads=1,  # one process per core already
    )
    for seed in seeds:
        spec = sample_spec(recipe, seed)
        if _play(env, dataset, spec):
            dataset.save_episode()
        else:
            dataset.clear_episode_buffer()
    dataset.finalize()
    env.close()
    return dataset.meta.total_frames


def _play(env: StraightforwardEnv, dataset: Any, spec: EpisodeSpec) -> bool:
    """Add the frames of one episode; tell whether it succeeded."""
    seen = env.begin(spec)
    expert = Intercept()
    for _ in range(spec.length_frames):
        before = seen
        action = expert.command(env.view()) - env.origin_w
        seen = env.step(action)[0]
        frame = {
            STATE: before["agent_pos"],
            PHASE: before["phase"].astype(np.float32),
            ACTION: env.executed.astype(np.float32),
            CAMERA_KEY: before["pixels"]["ego"],
        }
        dataset.add_frame(frame | {"task": spec.task})
    return env.success


def _features(image_size: int) -> dict[str, dict[str, Any]]:
    """Return LeRobot's description of the columns."""
    camera = image_feature("ego", image_size)
    features = {}
    for feature in (FEATURES["state"], FEATURES["phase"], FEATURES["action"], camera):
        dtype = "video" if feature is camera else feature.dtype
        names = list(feature.names)
        features[feature.key] = {"dtype": dtype, "shape": feature.shape, "names": names}
    return features
