"""Recording one world: copying its frames while it is played, freezing them into an Episode when it
ends.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from dynahoi_lerobot.captures import CaptureRule, Track
from dynahoi_lerobot.core.agent import Meeting, Observation
from dynahoi_lerobot.core.conventions import CONTROL_DT, EGO_VIEW, PALM_DOF
from dynahoi_lerobot.core.episode import Episode, EpisodeMeta
from dynahoi_lerobot.core.features import FEATURES, Feature
from dynahoi_lerobot.core.numerics import norm
from dynahoi_lerobot.core.spec import EpisodeSpec
from dynahoi_lerobot.motions import Motion
from dynahoi_lerobot.objects import TargetObject
from dynahoi_lerobot.objects.primitives import as_table, extent
from dynahoi_lerobot.rules import Rules
from dynahoi_lerobot.sampling.benchmark import BENCHMARK_ID
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.scene.model import SIDE_CAMERA
from dynahoi_lerobot.scene.pinhole import Pinhole
from dynahoi_lerobot.world.batch import WorldBatch


@dataclass(frozen=True)
class Job:
    """One episode to play.

    Attributes:
        index: position in the caller's order.
        spec: the episode.
        frames: longest recording [frames].
        attempt: from 1.
        stop_settled: whether to end once the capture rule has settled the outcome.
    """

    index: int
    spec: EpisodeSpec
    frames: int
    attempt: int = 1
    stop_settled: bool = False

    @classmethod
    def evaluation(cls, index: int, spec: EpisodeSpec, attempt: int = 1) -> Self:
        """Return the job of an evaluation: the window, up to L control steps, and the frame the
        last of them led to.
        """
        return cls(
            index, spec, spec.window_frames + spec.length_frames + 1, attempt, stop_settled=True
        )


TOUCH_M = 0.005
"""A fingertip this close touches the target: the sphere-overlap test of Appendix "Data
collection"."""
TIP_FRAMES = "tip_frames"
"""Column from which the fingertips' poses and distances are computed once an episode has ended."""
OBSERVED = [name for name, f in FEATURES.items() if f.observed and not f.derived]
"""Columns that are recorded as policies see them, but for images, by name in ``Observation``."""
CONTACTS = ("finger_force_n", "palm_force_n", "others")
"""Fields of ``TargetContacts``, which the capture rule judges; an episode keeps the fingers' forces
as ``touch``."""
JUDGED = ("state", "localized", "palm_distance_m", *CONTACTS)
"""Columns from which the capture rule reads its verdict."""


def measure_frame(
    batch: WorldBatch, observation: Observation, ids: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the arrays of worlds ``ids`` (n,) at this frame besides images, (n, ...) each, by name
    in ``Episode``, or for what `WorldRecorder` computes from them.
    """
    seen = {name: getattr(observation, name) for name in OBSERVED}
    columns = {name: values[ids] for name, values in seen.items() if values is not None}
    return columns | {
        TIP_FRAMES: batch.tip_frames(ids),
        "target_pose_h": batch.target_pose_h[ids],
        "target_velocity_w": batch.target_velocity_w[ids],
        "palm_distance_m": batch.palm_distance_m[ids],
        "localized": batch.localized[ids],
        "visual_state": batch.visual_state[ids],
        **{name: getattr(batch.contacts, name)[ids] for name in CONTACTS},
    }


@dataclass
class WorldRecorder:
    """Collects one world's frames."""

    job: Job
    frames: list[dict[str, np.ndarray]] = field(default_factory=list)
    images: dict[str, list[np.ndarray]] = field(default_factory=dict)
    localized_frames: int = 0
    succeeded: bool = False

    def add(self, frame: dict[str, np.ndarray], images: dict[str, np.ndarray]) -> None:
        """Record a frame.

        Args:
            frame: the measurements, and ``action``, ``given_action`` and ``executed_action`` of
                the step from it.
            images: (H, W, 3) uint8 by view, if any.
        """
        self.frames.append(frame)
        self.localized_frames += bool(frame["localized"])
        for view, pixels in images.items():
            self.images.setdefault(view, []).append(pixels)

    def settled(self, rule: CaptureRule) -> bool:
        """Tell whether the episode may end because the rule has settled its outcome."""
        return self.job.stop_settled and self.localized_frames > rule.settle_frames

    @property
    def visual_states(self) -> np.ndarray:
        """(T, nq + ngeom) all that the images of each frame depend on."""
        return np.stack([frame["visual_state"] for frame in self.frames])

    @property
    def full(self) -> bool:
        """Whether the episode has reached its longest length."""
        return len(self.frames) >= self.job.frames

    def success(self, rule: CaptureRule) -> bool:
        """Return the rule's verdict on the frames so far; a success is not judged again, for it
        lasts.
        """
        if self.localized_frames and not self.succeeded:
            self.succeeded = rule.success(self._track(self._columns(JUDGED)))
        return self.succeeded

    def freeze(self, batch: WorldBatch, i: int, actor: str, meeting: Meeting | None) -> Episode:
        """Return the recording of world ``i`` as an Episode of ``actor``, which planned ``meeting``
        at control start.
        """
        spec = self.job.spec
        rule = batch.rule
        columns = self._columns()
        columns |= _tip_columns(batch, i, columns)
        track = self._track(columns)
        columns |= episode_constants(batch, spec, meeting)
        columns |= {
            "captured": self._padded(rule.captured(track)),
            "succeeded": next_frames(self._padded(rule.succeeded(track))),
        }
        return Episode(
            meta=episode_meta(self.job, batch.rules, actor),
            images={view: np.stack(frames) for view, frames in self.images.items()},
            success=rule.success(track),
            stage=rule.stage(track),
            **{
                name: _typed(columns[name], feature)
                for name, feature in FEATURES.items()
                if name in columns
            },
        )

    def _padded(self, control: np.ndarray) -> np.ndarray:
        """(T,) bool of the control phase's frames, False in the window."""
        return np.concatenate([np.zeros(self.job.spec.window_frames, bool), control])

    def _columns(self, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """What was measured besides images, (T, ...) each, by default everything."""
        return {
            name: np.stack([frame[name] for frame in self.frames])
            for name in names or self.frames[0]
        }

    def _track(self, columns: dict[str, np.ndarray]) -> Track:
        """What the capture rule judges: the control phase."""
        spec = self.job.spec
        control = slice(spec.window_frames, None)
        return Track(
            joints=columns["state"][control, PALM_DOF:],
            open_joints=spec.open_joints.astype(
                np.float32
            ),  # as it is stored, for metrics to judge the same
            reference_joints=spec.reference_joints.astype(np.float32),
            localized=columns["localized"][control],
            contacts=TargetContacts(**{name: columns[name][control] for name in CONTACTS}),
            palm_distance_m=columns["palm_distance_m"][control],
            palm_pos_h=columns["state"][control, :PALM_DOF],
        )


def _tip_columns(
    batch: WorldBatch, i: int, columns: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return what follows from where the fingertips were in the T frames of world ``i``, (T, ...)
    each.
    """
    tips_m = batch.tip_distance(i, columns[TIP_FRAMES])
    pressed = columns["finger_force_n"] > 0
    return {
        "fingertips": batch.fingertips(i, columns[TIP_FRAMES]),
        "target_contacts": pressed if batch.rule.uses_contact_sensors else tips_m <= TOUCH_M,
        "fingertip_distance_m": np.maximum(tips_m.min(axis=1), 0.0),
    }


def next_frames(flags: np.ndarray) -> np.ndarray:
    """Return (T,) what follows each frame; the last one, whose successor is not recorded, stands
    for it.
    """
    return np.append(flags[1:], flags[-1:])


def _typed(value: Any, feature: Feature) -> Any:
    """A value in the feature's element type; one number as Python's."""
    array = np.asarray(value, feature.dtype)
    return array if array.ndim else array.item()


def episode_meta(job: Job, rules: Rules, agent: str) -> EpisodeMeta:
    """Return the facts of a job's episode, played by an agent under ``rules``."""
    spec = job.spec
    return EpisodeMeta(
        seed=spec.seed,
        split=spec.split,
        motion=spec.motion.name,
        category=spec.motion.category,
        object=spec.target.name,
        parameters=spec.motion.parameters(),
        task=spec.task,
        agent=agent,
        capture=rules.capture,
        protocol=spec.protocol,
        control_class=rules.control_class,
        control_mode=rules.control_mode,
        window_frames=spec.window_frames,
        length_frames=spec.length_frames,
        intercept_frame=spec.intercept_frame,
        attempts=job.attempt,
        code=spec.code,
        benchmark=BENCHMARK_ID,
    )


def episode_constants(
    batch: WorldBatch, spec: EpisodeSpec, meeting: Meeting | None
) -> dict[str, Any]:
    """Return what does not change in an episode, by name in ``Episode``; ``meeting`` is the plan at
    control start.
    """
    ego = Pinhole.of(batch.scene.model, EGO_VIEW)
    side = Pinhole.of(batch.scene.model, SIDE_CAMERA)
    return object_constants(spec.motion, spec.target) | {
        "home_pos_w": spec.home_pos_w,
        "target_path_h": spec.target_path_w - spec.home_pos_w,
        "intercept_pos_h": spec.intercept_pos_h,
        "intercept_s": spec.intercept_frame * CONTROL_DT,
        "open_joints": spec.open_joints,
        "reference_joints": spec.reference_joints,
        "ego_camera_pose_palm": ego.pose,
        "side_camera_pose_h": side.pose,
        "ego_intrinsics": ego.intrinsics(batch.cameras.image_size),
        "side_intrinsics": side.intrinsics(batch.cameras.image_size),
        "hand_limits": [
            batch.commands.palm_speed_m_s,
            batch.control.joint_speed_rad_s,
            batch.control.latency_ms,
        ],
        "first_plan": planned_speed_and_lead_time(spec, meeting),
    }


def object_constants(motion: Motion, target: TargetObject) -> dict[str, Any]:
    """Return the properties of the target besides its motion; SI units."""
    launch = motion.launch(target)
    own = target.friction if launch.friction is None else launch.friction
    struck = () if launch.striker is None else (launch.striker,)
    return {
        "object_primitives": as_table(target.primitives),
        "object_size": extent(target.primitives),
        "object_mass_kg": target.mass_kg,
        "object_inertia": target.inertia,
        # of two that touch, the greater counts
        "object_friction": [
            target.friction,
            max(own, *(box.friction for box in launch.boxes), 0.0),
        ],
        "object_restitution": max(
            launch.restitution, *(body.restitution for body in (*launch.boxes, *struck)), 0.0
        ),
    }


def planned_speed_and_lead_time(spec: EpisodeSpec, meeting: Meeting | None) -> tuple[float, float]:
    """Return what a plan at control start amounts to, as the paper's ``moveSpeed`` (Appendix "Data
    collection").

    Returns:
        The palm's straight way from home to the meeting over the time to it [m/s], and this time
        [s]; zeros for no plan.
    """
    if meeting is None:
        return 0.0, 0.0
    lead_s = (meeting.frame - spec.window_frames) * CONTROL_DT
    return norm(meeting.palm_pos_w - spec.home_pos_w) / lead_s, lead_s
