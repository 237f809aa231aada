"""Recording one world: copying its frames while it is played, freezing them into an Episode when it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynahoi_lerobot.agent import Observation
from dynahoi_lerobot.captures import CaptureRule, Track
from dynahoi_lerobot.episode import Episode, EpisodeMeta
from dynahoi_lerobot.episode_spec import EpisodeSpec
from dynahoi_lerobot.experts.base import open_hand, reference_grasp
from dynahoi_lerobot.foundation.conventions import PALM_DOF
from dynahoi_lerobot.hands.base import EGO_CAMERA
from dynahoi_lerobot.scene.contact_sensors import TargetContacts
from dynahoi_lerobot.world.batch import WorldBatch


@dataclass(frozen=True)
class Job:
    """One episode to play.

    Attributes:
        index: position in the caller's order.
        spec: the episode.
        frames: longest recording [frames].
        attempt: from 1.
        stop_settled: whether to end once the capture rule's verdict has fallen.
    """

    index: int
    spec: EpisodeSpec
    frames: int
    attempt: int = 1
    stop_settled: bool = False

    @classmethod
    def evaluation(cls, index: int, spec: EpisodeSpec) -> Job:
        """Return the job of an evaluation: the window and then up to L control steps."""
        return cls(index, spec, spec.window_frames + spec.length_frames, stop_settled=True)


COLUMNS = (
    "state",
    "fingertips",
    "phase",
    "target_pose",
    "target_velocity",
    "target_contacts",
    "palm_distance",
    "fingertip_distance",
    "localized",
    "touch",
    "palm_force",
    "other_contacts",
)
"""What is copied of every frame."""

VERDICT_COLUMNS = ("palm_force", "other_contacts")
"""Those that only the capture rule's verdict needs; the others are arrays of ``Episode`` by their names."""


def frame_columns(batch: WorldBatch, observation: Observation) -> dict[str, np.ndarray]:
    """Return ``COLUMNS`` of all N worlds at this frame, (N, ...) each."""
    tips = batch.tip_distance()
    values = (
        observation.state,
        observation.fingertips,
        observation.phase,
        batch.target_pose,
        batch.target_velocity,
        batch.touching(),
        batch.palm_distance.copy(),
        np.maximum(tips.min(axis=1), 0.0),
        batch.localized.copy(),
        batch.contacts.finger_force_n.copy(),
        batch.contacts.palm_force_n.copy(),
        batch.contacts.others.copy(),
    )
    return dict(zip(COLUMNS, values, strict=True))


@dataclass
class WorldRecorder:
    """Collects one world's frames: ``add_frame`` before each step, ``add_action`` after it."""

    job: Job
    frames: list[tuple[np.ndarray, ...]] = field(default_factory=list)
    pictures: dict[str, list[np.ndarray]] = field(default_factory=dict)
    actions: list[np.ndarray] = field(default_factory=list)
    localized_frames: int = 0

    def add_frame(self, columns: dict[str, np.ndarray], i: int, pictures: dict[str, np.ndarray]) -> None:
        """Record what world ``i`` looks like at this frame; ``pictures`` are (N, H, W, 3) of each view."""
        self.frames.append(tuple(columns[name][i] for name in COLUMNS))
        self.localized_frames += bool(columns["localized"][i])
        for view, images in pictures.items():
            self.pictures.setdefault(view, []).append(images[i])

    def add_action(self, executed: np.ndarray) -> None:
        """Record the command (18,) that was executed from this frame on."""
        self.actions.append(executed.copy())

    def settled(self, rule: CaptureRule) -> bool:
        """Tell whether the episode may end because the rule's verdict has fallen."""
        return self.job.stop_settled and self.localized_frames > rule.settle_frames

    @property
    def full(self) -> bool:
        """Whether the episode has reached its longest length."""
        return len(self.actions) >= self.job.frames

    def success(self, rule: CaptureRule) -> bool:
        """Return the rule's verdict on the frames so far."""
        return self.localized_frames > 0 and rule.success(self._track(self._columns()))

    def freeze(self, rule: CaptureRule, actor: str) -> Episode:
        """Return the recording as an Episode."""
        spec, columns = self.job.spec, self._columns()
        track = self._track(columns)
        captured = np.zeros(len(self.frames), bool)
        captured[spec.window_frames :] = rule.captured(track)
        touch, localized = columns.pop("touch"), columns.pop("localized")
        floats = {name: values.astype(np.float32) for name, values in columns.items() if name not in VERDICT_COLUMNS}
        views = {view: np.stack(images) for view, images in self.pictures.items()}
        return Episode(
            meta=_meta(self.job, rule.name, actor),
            images=views.pop(EGO_CAMERA, None),
            action=np.stack(self.actions).astype(np.float32),
            localized=localized,
            captured=captured,
            intercept_position=spec.intercept_pos_w.astype(np.float32),
            intercept_time=spec.intercept_time_s,
            open_joints=track.open_joints.astype(np.float32),
            reference_joints=track.reference_joints.astype(np.float32),
            success=rule.success(track),
            stage=rule.stage(track),
            touch=touch.astype(np.float32) if rule.uses_contact_sensors else None,
            views=views,
            **floats,
        )

    def _columns(self) -> dict[str, np.ndarray]:
        stacked = [np.stack(values) for values in zip(*self.frames, strict=True)]
        return dict(zip(COLUMNS, stacked, strict=True))

    def _track(self, columns: dict[str, np.ndarray]) -> Track:
        """What the capture rule judges: the control phase."""
        spec = self.job.spec
        control = slice(spec.window_frames, None)
        return Track(
            joints=columns["state"][control, PALM_DOF:],
            open_joints=open_hand(),
            reference_joints=reference_grasp(spec),
            localized=columns["localized"][control],
            contacts=TargetContacts(*(columns[name][control] for name in ("touch", "palm_force", "other_contacts"))),
            palm_distance=columns["palm_distance"][control],
            palm_pos_w=columns["state"][control, :PALM_DOF],
        )


def _meta(job: Job, capture: str, agent: str) -> EpisodeMeta:
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
        capture=capture,
        protocol=spec.protocol,
        window_frames=spec.window_frames,
        length_frames=spec.length_frames,
        intercept_frame=spec.intercept_frame,
        attempts=job.attempt,
        fingerprint=spec.fingerprint,
    )
