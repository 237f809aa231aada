"""What a dataset of DynaHOI says beside its frames: of the robot, of the rules, and of where the
targets are.

The last is read for training alone and never becomes an observation. Datasets from elsewhere say
nothing of it, and only their actions are learned.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
import yaml
from lerobot.configs import parser
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor

from .configuration_obact import (
    CONTACT,
    IMAGES,
    SHIPPED_WEIGHTS,
    SIGHTINGS,
    Embodiment,
    ObActConfig,
    view_of,
)
from .teacher import LONGEST_FRAMES, Targets, Teacher

SHIPPED_SENSOR = "eye"
"""Name of the image sensor of `dynahoi encode` that sees as the eyes that ship do."""
ROBOT_TYPE = "dynahoi_hand"
"""LeRobot's ``robot_type`` of a dataset of DynaHOI, also after other tools have edited it."""
SCHEMA = 1
"""Schema of the manifests of such datasets that are read here. The names of their tables and
columns, which the card of each explains:"""
EPISODES = "meta/episodes"  # a row per episode
CAPTURE = "capture"
WINDOW = "window_frames"
TRUTH = "meta/privileged"  # a row per frame
LOCALIZED = "localized"
TARGET_POSE = "target.pose"
CONSTANTS = "meta/privileged_episodes"  # a row per episode
TARGET_PATH = "target_path"
HAND_LIMITS = "hand_limits"
OPEN_JOINTS = "open_joints"
CLOSED_JOINTS = "reference_joints"
CAMERA_POSE = "{}_camera"
CAMERA_INTRINSICS = "{}_intrinsics"
RADIUS_M = {"attach": 0.03, "attach_lenient": 0.1}
"""Distance within which a palm has caught the target, by capture rule [m]."""
CARRIED_VIEW = "ego"  # the view of the camera that the palm carries
CLOSED_QUANTILE = 0.6
"""Objects differ by 6 % in how far a hand closes around them; closing a little too far grasps more
of them."""


def adopt(config: ObActConfig, meta: Any) -> TargetTable | None:
    """Take over what a dataset says of robot, rules and features into a config; return its targets
    if the policy learns to forecast them.

    Raises:
        ValueError: if the policy cannot learn from the dataset as it is configured.
    """
    provenance = provenance_of(meta)
    config.rules = _rules_in(provenance)
    if not config.encoder and meta.robot_type != ROBOT_TYPE:
        config.encoder = "conv"  # the eyes that ship have learned from images of that robot alone
    if config.relative_dims is None and _displaces(meta):
        config.relative_dims = 0
    config.validate_features()
    forecast_before = bool(config.embodiment.capture)
    config.embodiment = embodiment_of(meta, config.cameras)
    if config.pretrained_path and not forecast_before:
        # without a forecast the network has other layers
        config.embodiment = replace(config.embodiment, capture="")
    if config.pretrained_path and forecast_before and not config.forecasts:
        raise ValueError(
            f"{config.pretrained_path} learned to forecast the target, but from {meta.repo_id} it "
            f"would learn actions alone, by another network: {_why_no_forecast(config, meta)}"
        )
    _check_encoder(config, meta, provenance)
    if not config.forecasts:
        config.embodiment = replace(config.embodiment, capture="")
        _warn(config, meta, "it learns actions alone, without the target's path")
        return None
    if not config.n_future_steps:
        _warn(config, meta, "n_future_steps is 0")
    # it reads no other vectors, which a robot may not have
    read = {*config.cameras, OBS_STATE}
    features = config.input_features or {}
    config.input_features = {key: x for key, x in features.items() if key in read}
    return TargetTable.of(meta, config.embodiment)


def _why_no_forecast(config: ObActConfig, meta: Any) -> str:
    """Return why a policy that forecast before cannot go on so."""
    if config.embodiment.capture:
        return (
            f"forecast_weight is {config.forecast_weight} and freeze_encoder is "
            f"{config.freeze_encoder}, but must be above 0 and true"
        )
    return (
        "it has no target's path, or displacements as actions; train on one that has the path, as "
        "dynahoi generate writes it, or from random weights"
    )


def _warn(config: ObActConfig, meta: Any, reason: str) -> None:
    """Say why the closed loop is off for a dataset that was encoded for it."""
    if is_encoded(config, meta):
        logging.warning("the closed loop is off for %s: %s", meta.repo_id, reason)


def _displaces(meta: Any) -> bool:
    """Whether actions say how far the palm goes from where it is, not where to: those of DynaHOI's
    hand then have another shape than its state.
    """
    shapes = [meta.features.get(key, {}).get("shape") for key in (ACTION, OBS_STATE)]
    return meta.robot_type == ROBOT_TYPE and shapes[0] != shapes[1]


def is_encoded(config: ObActConfig, meta: Any) -> bool:
    """Whether a dataset has sightings in place of the images."""
    return meta.features.keys() >= {*config.sighting_keys}


def _check_encoder(config: ObActConfig, meta: Any, provenance: dict[str, Any]) -> None:
    """Refuse options that the encoder would ignore, and data that it could not read."""
    encoded = is_encoded(config, meta)
    if config.n_future_steps and not encoded:
        raise ValueError(
            f"n_future_steps is {config.n_future_steps}, but must be 0 for a dataset with images, "
            "of which it would decode as many more: give --policy.n_future_steps=0, or what "
            "`dynahoi encode` makes of it"
        )
    whole = config.encoder == "eye" and not config.encoder_options.get("embedding")
    if encoded and not (whole and config.freeze_encoder):
        raise ValueError(
            f"{meta.repo_id} has sightings instead of images, which only the frozen eye without an "
            f"embedding reads, but encoder is {config.encoder!r}, freeze_encoder "
            f"{config.freeze_encoder} and encoder_options {config.encoder_options}"
        )
    sensor = (provenance.get("encoded") or {}).get("sensor", SHIPPED_SENSOR)
    if encoded and (sensor == SHIPPED_SENSOR) != config.acts_with_shipped_eyes:
        raise ValueError(
            f"{meta.repo_id} holds what the sensor {sensor!r} saw, but encoder_options is "
            f"{config.encoder_options}, with which the policy would act: the weights of 'eye' are "
            f"{SHIPPED_WEIGHTS!r}"
        )
    if config.freeze_encoder and image_transforms_enabled():
        raise ValueError(
            "dataset.image_transforms.enable is true, but must be false for a frozen encoder, "
            "which has learned from other images and cannot learn from these"
        )


def image_transforms_enabled() -> bool:
    """Whether `lerobot-train` was asked to change images at random.

    It shows that to no policy, so its command line and config file are read, as LeRobot itself does
    for the path of a policy. A training that a program starts by a function call is not seen.
    """
    told = parser.parse_arg("dataset.image_transforms.enable")
    file = parser.parse_arg("config_path")
    if told is None and file and Path(file).is_file():
        dataset = yaml.safe_load(Path(file).read_text()).get("dataset") or {}
        told = (dataset.get("image_transforms") or {}).get("enable")
    return str(told).lower() in ("true", "1", "yes")


def columns_of(meta: Any, folder: str, wanted: Iterable[str]) -> dict[str, list[Any]]:
    """Return the ``wanted`` columns that the table in a folder has, in the order of episodes and
    frames; nothing if the dataset has no such table.
    """
    if not (meta.root / folder).is_dir():
        return {}
    held = pq.ParquetDataset(meta.root / folder).schema.names
    order = [key for key in ("episode_index", "frame_index") if key in held]
    names = sorted({*wanted, *order} & {*held})
    table = pq.read_table(meta.root / folder, columns=names)
    table = table.sort_by([(key, "ascending") for key in order])
    return {name: table[name].to_pylist() for name in names}


def _rules_in(provenance: dict[str, Any]) -> dict[str, Any]:
    """Return how the episodes of a dataset were played; nothing if that is not known."""
    told = provenance
    for key in ("recording", "recipe", "rules"):
        told = told.get(key) or {}
    return told


def provenance_of(meta: Any) -> dict[str, Any]:
    """Return how a dataset came about, as its manifest says; nothing if it has none.

    Raises:
        ValueError: if the manifest is of another schema than the one that is read here.
    """
    path = meta.root / "meta" / "manifest.json"
    if not path.exists():
        return {}
    manifest = json.loads(path.read_text())
    found = manifest.get("schema")
    if found != SCHEMA:
        raise ValueError(
            f"{path} has schema {found!r}, and this policy reads schema {SCHEMA}; generate the "
            "dataset again"
        )
    return manifest.get("provenance") or {}


def embodiment_of(meta: Any, cameras: list[str]) -> Embodiment:
    """Return what a dataset says of its clock, its cameras, its hand and its targets.

    Raises:
        ValueError: if the dataset knows the poses of its cameras, but has one of ``cameras`` under
            another name.
    """
    columns = {HAND_LIMITS, TARGET_PATH}
    for view in map(view_of, cameras):
        columns |= {CAMERA_POSE.format(view), CAMERA_INTRINSICS.format(view)}
    constants = columns_of(meta, CONSTANTS, columns)
    held = {name.replace(SIGHTINGS, IMAGES) for name in meta.features}
    for key in cameras if constants else ():
        if key not in held:
            raise ValueError(
                f"{meta.repo_id} has no {key}, under whose name ObAct looks up the camera's pose: "
                f"train without --rename_map, from random weights"
            )
    speed_m_s, _, latency_ms = constants.get(HAND_LIMITS, [(0.0, 0.0, 0.0)])[0]
    capture = _learnable_capture(meta, constants)
    return Embodiment(
        fps=float(meta.fps),
        calibration={
            key: _calibration(view_of(key), constants)
            for key in cameras
            if CAMERA_POSE.format(view_of(key)) in constants
        },
        delay_frames=math.ceil(latency_ms / 1000 * meta.fps - 1e-6),
        palm_speed_m_s=float(speed_m_s),
        capture=capture,
        radius_m=RADIUS_M.get(capture, Embodiment.radius_m),
    )


def _calibration(view: str, constants: dict[str, list[Any]]) -> list[float]:
    """Return the calibration of the camera of a view, see `Embodiment`."""
    focal_px, _, center_px, _ = constants[CAMERA_INTRINSICS.format(view)][0]
    pose = constants[CAMERA_POSE.format(view)][0]
    return [*pose, center_px / focal_px, float(view == CARRIED_VIEW)]


def _learnable_capture(meta: Any, constants: dict[str, list[Any]]) -> str:
    """Return the rule of capture; empty if nothing beside the recorded actions can be learned."""
    captures = columns_of(meta, EPISODES, {CAPTURE}).get(CAPTURE)
    if meta.robot_type == ROBOT_TYPE and not constants:
        logging.warning(
            "%s is gone, which LeRobot's tools drop when they edit a dataset: the closed loop is "
            "off, and only actions are learned",
            meta.root / CONSTANTS,
        )
    known = TARGET_PATH in constants and (meta.root / TRUTH).is_dir()
    # of displacements, the teacher's answers would be of another kind
    if not (captures and known) or _displaces(meta):
        return ""
    return captures[0] or ""


@dataclass(frozen=True)
class TargetTable:
    """Where the targets of E episodes are, and what should be done about them."""

    path: Tensor  # of the untouched target [m], (E, F, 3)
    length: Tensor  # known frames of that, (E,)
    catch: Tensor  # the frame in which the recorded hand has caught it, (E,)
    begin: Tensor  # the frame in which the hand may move, (E,)
    first_index: Tensor  # of the dataset, of the frames of an episode, (E,)
    # in the loss, of a window, (E,): less in episodes with more windows, so that all count alike
    weight: Tensor
    teacher: Teacher
    count: Tensor  # recorded frames, (E,)
    # of the recorded target, which a hand may have moved [m], (E, T, 3), if hands must grip it
    recorded_path: Tensor | None = None

    @classmethod
    def of(cls, meta: Any, embodiment: Embodiment) -> TargetTable:
        """Return the table of the dataset that ``meta`` describes, which has the target's path."""
        table = columns_of(meta, EPISODES, {"length", WINDOW})
        constants = columns_of(meta, CONSTANTS, {TARGET_PATH, OPEN_JOINTS, CLOSED_JOINTS})
        grips = embodiment.capture == CONTACT
        truth = columns_of(meta, TRUTH, {LOCALIZED, TARGET_POSE} if grips else {LOCALIZED})
        count = torch.tensor(table["length"])
        if not np.array_equal(np.bincount(truth["episode_index"]), count):
            raise ValueError(
                f"{meta.root / TRUTH} is of other episodes than {meta.root / EPISODES}: another "
                "tool has edited the dataset; `dynahoi verify` says what is left of it"
            )
        paths = [torch.tensor(np.array(path, np.float32)) for path in constants[TARGET_PATH]]
        flags = torch.tensor(truth[LOCALIZED]).split(count.tolist())
        catch = torch.tensor([int((~caught).cumprod(0).sum()) for caught in flags])
        # open ones are the same in all episodes
        open_joints, closed_joints = (
            torch.tensor(constants[name], dtype=torch.float32).quantile(CLOSED_QUANTILE, dim=0)
            for name in (OPEN_JOINTS, CLOSED_JOINTS)
        )
        recorded_path = None
        if grips:
            catch += 1  # fingers that are told to close in a frame are closed in the next
            places = torch.tensor(np.array(truth[TARGET_POSE], np.float32)[:, :3])
            recorded = list(places.split(count.tolist()))
            recorded_path = torch.nn.utils.rnn.pad_sequence(recorded, batch_first=True)
        learned = count if grips else catch
        return cls(
            path=torch.nn.utils.rnn.pad_sequence(paths, batch_first=True),
            length=torch.tensor([len(path) for path in paths]),
            catch=catch,
            begin=torch.tensor([frames or 0 for frames in table[WINDOW]], dtype=torch.long),
            first_index=count.cumsum(0) - count,
            weight=learned.float().mean() / learned.clamp_min(1),
            teacher=_teacher_of(embodiment, open_joints, closed_joints),
            count=count,
            recorded_path=recorded_path,
        )

    def window(
        self, episode: Tensor, newest: Tensor, offsets: list[int], delay_frames: int = 0
    ) -> tuple[Targets, Tensor]:
        """Return targets of episodes ``(B,)`` in windows of the frames at ``offsets`` from the
        ``newest`` ones ``(B,)``, and the frames in which the hands may move, both counted from the
        first.

        Their paths go on beyond a window, as far as a teacher looks from ``delay_frames`` after its
        last frame, when a command that is decided there takes effect. A target waits before its
        recording, and where its path is no longer known. One that the hand grips is where it was
        recorded.
        """
        first = newest + offsets[0]
        frame = first[:, None] + torch.arange(len(offsets) + delay_frames + LONGEST_FRAMES)
        catch = self.catch[episode]
        length = self.length[episode]
        inside = torch.minimum(frame.clamp_min(0), length[:, None] - 1)
        path = self.path[episode[:, None], inside]
        gripped = torch.zeros_like(catch, dtype=torch.bool)
        if self.recorded_path is not None:
            gripped = newest >= catch
            length = torch.where(gripped, self.count[episode], length)
            inside = torch.minimum(frame.clamp_min(0), self.count[episode, None] - 1)
            recorded = self.recorded_path[episode[:, None], inside]
            path = torch.where(gripped[:, None, None], recorded, path)
        return Targets(path, length - first, catch - first, gripped), self.begin[episode] - first


def _teacher_of(embodiment: Embodiment, open_joints: Tensor, closed_joints: Tensor) -> Teacher:
    """Return the teacher of a hand, under the rule of capture.

    Raises:
        ImportError: if targets must be gripped, and the expert that knows how is not installed.
    """
    fps = embodiment.fps
    step_m = embodiment.step_m
    if embodiment.capture != CONTACT:
        return Teacher(fps, step_m, open_joints, closed_joints, embodiment.radius_m)
    try:
        from .grip import GRIP_M, Grip
    except ImportError as error:
        raise ImportError(
            "targets that must be gripped are learned from the expert 'match' of dynahoi_lerobot: "
            "install lerobot_policy_obact[contact]"
        ) from error
    return Grip(fps, step_m, open_joints, closed_joints, GRIP_M)
