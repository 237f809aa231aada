"""The policy through LeRobot's own commands: any dataset, recorded episodes, checkpoints, history,
servers.
"""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, count, pairwise, repeat
from pathlib import Path

import draccus
import numpy as np
import pytest
import torch
from draccus.utils import ParsingError
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, modify_features
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.policies.rtc import RTCConfig
from lerobot.rollout.inference.rtc import supports_rtc_inference
from lerobot.utils.feature_utils import dataset_to_policy_features
from lerobot_policy_obact import ObActConfig, ObActPolicy, dataset
from lerobot_policy_obact.commands import CommandBuffer
from lerobot_policy_obact.configuration_obact import Embodiment
from lerobot_policy_obact.encoders import SHIPPED
from lerobot_policy_obact.frames import ObservationHistory, stepped
from lerobot_policy_obact.teacher import LONGEST_FRAMES
from safetensors.torch import load_file
from torch.utils.data import DataLoader

from dynahoi_lerobot.dataset import episode_column
from dynahoi_lerobot.encode import encode
from tests.checkpoints import FEATURES, SMALL_GR00T, TINY_OBACT, observation, window_of
from tests.checkpoints import SHIPPED as SHIPPED_POLICY
from tests.tools import generated, lerobot_train, options, python, run

N_EPISODES = 2
N_FRAMES = 30
FPS = 10
SIZE = 96
CAMERA = "observation.images.side"
NEW = {"type": "obact"}
TINY = TINY_OBACT | {
    "horizon": 4,
    "n_action_steps": 2,
    "n_obs_steps": 3,
    "device": "cpu",
    "push_to_hub": False,
    "relative_dims": 2,
}
CHANGED = {"dataset.image_transforms.enable": True}
"""An option of LeRobot's training that changes images."""
HAND = {name: FEATURES[name] for name in ("input_features", "output_features")}


@pytest.fixture(scope="module")
def push_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset like PushT's: one camera, two coordinates, no hand and no target. Its image has the
    name and the size of those of one of our cameras.
    """
    sizes = {"observation.state": 2, "action": 2}
    return pushes(tmp_path_factory.mktemp("push") / "data", sizes)


def pushes(root: Path, sizes: dict[str, int]) -> Path:
    """A dataset with an image and vectors that wander, of these sizes; actions are the next
    states.
    """
    image = {"dtype": "image", "shape": (SIZE, SIZE, 3), "names": ["height", "width", "channel"]}
    vectors = {
        key: {"dtype": "float32", "shape": (size,), "names": None} for key, size in sizes.items()
    }
    features = {CAMERA: image} | vectors
    dataset = LeRobotDataset.create("local/tiny", FPS, features, root=root, use_videos=False)
    rng = np.random.default_rng(0)
    for _ in range(N_EPISODES):
        walk = rng.normal(size=(N_FRAMES + 1, max(sizes.values()))).cumsum(0).astype(np.float32)
        for here, there in pairwise(walk):
            frame = {key: (there if key == "action" else here)[:n] for key, n in sizes.items()}
            frame[CAMERA] = rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
            dataset.add_frame(frame | {"task": "push"})
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture(scope="module")
def image_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recorded episodes of DynaHOI."""
    return generated(tmp_path_factory.mktemp("hand") / "data", "--image-size", "96", episodes=4)


@pytest.fixture(scope="module")
def hand_root(image_root: Path) -> Path:
    """The same episodes, encoded."""
    encode(image_root, image_root.with_name("encoded"))
    return image_root.with_name("encoded")


RECORDED = {
    "encoder": "",
    "encoder_options": {},
    "freeze_encoder": None,
    "relative_dims": None,
    "n_obs_steps": 13,
    "n_future_steps": 24,
    "n_decisions": 3,
}


def metadata(root: Path) -> LeRobotDatasetMetadata:
    return LeRobotDatasetMetadata("local/tiny", root=root)


def features_of(root: Path) -> dict[str, PolicyFeature]:
    return dataset_to_policy_features(metadata(root).features)


def step(policy: ObActPolicy, n: int = 2, seed: int = 0) -> dict[str, torch.Tensor]:
    return observation(policy.config, n, seed)


def at(time_s: float, batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The batch, seen at a time."""
    return batch | {"timestamp": torch.tensor([time_s])}


def hand_policy(**changes: object) -> ObActPolicy:
    torch.manual_seed(0)
    return ObActPolicy(ObActConfig(**TINY | HAND | changes)).eval()


def learner(root: Path, **changes: object) -> ObActPolicy:
    """A policy that is about to learn from recorded episodes."""
    meta = metadata(root)
    inputs = {key: feature for key, feature in features_of(root).items() if key != "action"}
    config = ObActConfig(**TINY | HAND | RECORDED | {"input_features": inputs} | changes)
    torch.manual_seed(0)
    return ObActPolicy(config, dataset_stats=meta.stats, dataset_meta=meta).train()


def batch_of(
    policy: ObActPolicy, root: Path, n: int = 4, episodes: list[int] | None = None
) -> dict[str, torch.Tensor]:
    """The first batch that LeRobot would make for a policy."""
    times = resolve_delta_timestamps(policy.config, metadata(root))
    found = LeRobotDataset("local/tiny", root=root, delta_timestamps=times, episodes=episodes)
    return next(iter(DataLoader(found, batch_size=n, shuffle=True)))


# -- training --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left_out", "head"),
    [
        ([], {}),
        (["observation.state"], {}),
        ([], {"head": "gr00t", "head_options": SMALL_GR00T}),
    ],
    ids=["state", "images alone", "gr00t"],
)
def test_the_defaults_fit_any_dataset(
    left_out: list[str], head: dict[str, object], push_root: Path, tmp_path: Path
):
    root = push_root
    if left_out:
        root = tmp_path / "images"
        source = LeRobotDataset("local/tiny", root=push_root)
        modify_features(source, remove_features=left_out, output_dir=root)
    bare = {"device": "cpu", "push_to_hub": False} | head
    checkpoint = lerobot_train(root, tmp_path / "out", NEW | bare, **CHANGED)
    policy = ObActPolicy.from_pretrained(checkpoint)
    config = policy.config
    assert (config.encoder, config.freeze_encoder, config.forecasts) == ("conv", False, False)
    assert config.embodiment.fps == FPS
    assert config.relative_dims == 2 - len(left_out) * 2, "as many as state and action have"
    assert policy.select_action(step(policy)).isfinite().all()


def test_it_learns_from_recorded_episodes_with_the_target_s_path(hand_root: Path, tmp_path: Path):
    checkpoint = lerobot_train(hand_root, tmp_path / "out", NEW | TINY | RECORDED)
    policy = ObActPolicy.from_pretrained(checkpoint)
    config = policy.config
    assert config.forecasts
    assert (config.encoder, config.freeze_encoder) == ("eye", True)
    assert set(config.input_features) == {"observation.images.ego", "observation.state"}, (
        "it acts on images, and a robot has no phase"
    )
    embodiment = config.embodiment
    assert (embodiment.palm_speed_m_s, embodiment.delay_frames) == (0.5, 0), "of class standard"
    pose = embodiment.calibration["observation.images.ego"]
    assert pose[:3] == pytest.approx([-0.15, 0.03, 0.21]), "where the hand's camera is"
    assert policy.select_action(step(policy)).shape == (2, 18)


@pytest.mark.parametrize(
    ("changes", "falls"),
    [
        ({"virtual_share": 0.0}, "forecast"),
        ({"virtual_share": 1.0}, "forecast"),
        ({"forecast_weight": 0.0}, "action"),
    ],
    ids=["recorded", "virtual", "actions alone"],
)
def test_the_loss_falls(changes: dict, falls: str, hand_root: Path):
    policy = learner(hand_root, **changes)
    batch = batch_of(policy, hand_root)
    optimizer = torch.optim.Adam(policy.get_optim_params(), lr=3e-3)
    losses = []
    for _ in range(60):
        loss, told = policy(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(told[falls])
    assert ("forecast" in told) == ("closed_loop" in told) == (falls != "action"), (
        "without a path there is neither"
    )
    assert np.mean(losses[-10:]) < 0.85 * np.mean(losses[:10])
    one_each, _ = policy(batch, reduction="none")
    assert one_each.shape == (4,)


def test_images_and_their_sightings_are_the_same_to_a_frozen_encoder(image_root, hand_root):
    found = []
    for root in (image_root, hand_root):
        policy = learner(root, n_future_steps=0, n_obs_steps=40)
        torch.manual_seed(0)
        found.append(window_of(policy, batch_of(policy, root, n=8)).frames)
    images, columns = found
    torch.testing.assert_close(images.state, columns.state)
    assert images.hidden.equal(columns.hidden)
    seen = ~images.hidden
    # the video is decoded in full color by one reader and not by the other
    torch.testing.assert_close(images.sightings[seen], columns.sightings[seen], atol=0.1, rtol=0)


@pytest.mark.parametrize("episodes", [None, [1, 3]], ids=["all", "some episodes"])
def test_a_window_shows_the_target_as_it_moves_from_its_first_frame_on(episodes, hand_root):
    policy = learner(hand_root)
    batch = batch_of(policy, hand_root, n=16, episodes=episodes)
    window = window_of(policy, batch)
    paths = episode_column(hand_root, "target_path")
    for i, (episode, index) in enumerate(zip(batch["episode_index"], batch["index"], strict=True)):
        first = int(index - policy.targets.first_index[episode]) - 12
        path = torch.from_numpy(paths[int(episode)])
        shown = torch.arange(first, first + 61).clamp(0, len(path) - 1)
        torch.testing.assert_close(window.targets.path[i, :61], path[shown])
        assert window.frames.hidden[i].sum() == max(0, -first)


EYE = {"encoder": "eye", "freeze_encoder": True}
FOR_ITS_EYE = "has sightings instead of images, which only"
OTHER_EYE = "holds what the sensor 'eye' saw, but encoder_options is .*the weights of 'eye'"
RENAMED = {
    "observation.images.camera1": PolicyFeature(FeatureType.VISUAL, (3, 96, 96)),
    "observation.state": PolicyFeature(FeatureType.STATE, (18,)),
}


@pytest.mark.parametrize(
    ("root", "changes", "said"),
    [
        ("image_root", {}, "must be 0 .* --policy.n_future_steps=0, or .* `dynahoi encode`"),
        ("hand_root", {"encoder": "conv", "freeze_encoder": None}, FOR_ITS_EYE),
        ("hand_root", {"freeze_encoder": False}, FOR_ITS_EYE),
        ("hand_root", EYE | {"encoder_options": {"channels": 8}}, OTHER_EYE),
        ("hand_root", EYE | {"encoder_options": {"weights": "side_96"}}, OTHER_EYE),
        ("hand_root", {"input_features": RENAMED}, "no observation.images.camera1.*--rename_map"),
    ],
    ids=[
        "images of frames to come",
        "sightings to conv",
        "to an eye that learns",
        "to an eye with random weights",
        "to the eye of another view",
        "no pose",
    ],
)
def test_a_dataset_that_it_cannot_learn_from_is_refused(
    root: str, changes: dict, said: str, request: pytest.FixtureRequest
):
    with pytest.raises(ValueError, match=said):
        learner(request.getfixturevalue(root), **changes)


def test_training_goes_on_and_begins_from_a_checkpoint(push_root: Path, tmp_path: Path):
    first = lerobot_train(push_root, tmp_path / "first", NEW | TINY)
    words = {"config_path": first / "train_config.json", "resume": True, "steps": 4}
    run(["lerobot-train", *options(words)])
    state = tmp_path / "first/checkpoints/000004/training_state/training_step.json"
    assert json.loads(state.read_text())["step"] == 4

    slow = {"path": first, "optimizer_lr": 1e-12}
    tuned = load_file(lerobot_train(push_root, tmp_path / "tuned", slow) / "model.safetensors")
    began = load_file(first / "model.safetensors")
    for name, weight in began.items():
        torch.testing.assert_close(tuned[name], weight, atol=1e-6, rtol=0, msg=name)


def test_without_the_targets_path_the_closed_loop_is_off_and_says_so(hand_root, tmp_path, caplog):
    root = shutil.copytree(hand_root, tmp_path / "other")
    for folder in ("privileged", "privileged_episodes"):
        shutil.rmtree(root / "meta" / folder)
    policy = learner(root)
    assert "the closed loop is off for local/tiny: it learns actions alone" in caplog.text
    assert set(policy(batch_of(policy, root))[1]) == {"action"}


def test_the_last_frame_of_a_window_is_taught_for_when_its_command_takes_effect(
    hand_root: Path, monkeypatch: pytest.MonkeyPatch
):
    """Without frames to come, with inference as late as it may be, on a target's long path."""
    policy = learner(hand_root, n_obs_steps=1, n_future_steps=0)
    longest = int(policy.targets.length.argmax())
    assert policy.targets.length[longest] > LONGEST_FRAMES + policy.config.horizon
    monkeypatch.setattr(policy, "_drawn_inference_delay", lambda: policy.config.horizon - 1)
    batch = batch_of(policy, hand_root)
    batch["episode_index"] = torch.full_like(batch["index"], longest)
    batch["index"] = policy.targets.first_index[batch["episode_index"]]
    assert policy(batch)[0].isfinite()


@pytest.mark.parametrize("name", ["action", "observation.state", "observation.gripper"])
def test_a_vector_may_have_one_entry(name: str, tmp_path: Path):
    """LeRobot delivers it as a scalar."""
    root = pushes(tmp_path / "data", {"observation.state": 2, "action": 2} | {name: 1})
    bare = {"device": "cpu", "push_to_hub": False}
    checkpoint = lerobot_train(root, tmp_path / "out", NEW | bare, **CHANGED)
    policy = ObActPolicy.from_pretrained(checkpoint)
    assert policy.select_action(step(policy)).isfinite().all()


def test_episodes_count_alike_however_many_windows_show_them(hand_root):
    policy = learner(hand_root, virtual_share=0.0, n_hands=2)
    targets = policy.targets
    batch = batch_of(policy, hand_root)
    losses = []
    assert targets.catch.unique().numel() > 1
    mean = targets.catch.float().mean()
    torch.testing.assert_close(targets.weight * targets.catch, mean.expand(4))
    for of_first in (1.0, 3.0):
        weight = torch.ones(4)
        weight[batch["episode_index"][0]] = of_first
        policy.targets = replace(targets, weight=weight)
        torch.manual_seed(0)
        losses.append(policy(batch, reduction="none")[0])
    shares = torch.where(batch["episode_index"] == batch["episode_index"][0], 3.0, 1.0)
    torch.testing.assert_close(losses[1], losses[0] * shares)


def test_each_camera_starts_from_weights_of_its_own():
    images = {
        f"observation.images.{view}": PolicyFeature(FeatureType.VISUAL, (3, 32, 32))
        for view in ("ego", "side")
    }
    state = {"observation.state": PolicyFeature(FeatureType.STATE, (18,))}
    policy = hand_policy(
        input_features=images | state,
        encoder="eye",
        encoder_options={"weights": "{view}_96"},
        relative_dims=3,
    )
    for eye, name in zip(policy.model.encoders, ("ego_96", "side_96"), strict=True):
        torch.testing.assert_close(
            eye.attention.query.weight, load_file(SHIPPED[name])["attention.query.weight"]
        )


def test_sightings_without_a_state_teach_actions(hand_root: Path, tmp_path: Path):
    root = tmp_path / "stateless"
    source = LeRobotDataset("local/tiny", root=hand_root)
    others = ["observation.phase", "observation.touch"]
    gone = ["observation.state", *(key for key in others if key in source.features)]
    modify_features(source, remove_features=gone, output_dir=root)
    policy = learner(root)
    assert set(policy(batch_of(policy, root))[1]) == {"action"}
    assert policy.select_action(step(policy)).isfinite().all()


@pytest.mark.parametrize("edited", [False, True], ids=["whole", "edited by LeRobot's tools"])
def test_actions_that_are_displacements_do_not_count_from_the_palm(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, *, edited: bool
):
    root = generated(
        tmp_path / "grasp", "--image-size", "96", "--control-mode", "grasp", episodes=2
    )
    if edited:
        root = tmp_path / "one"
        source = LeRobotDataset("local/tiny", root=tmp_path / "grasp")
        delete_episodes(source, [0], output_dir=root)
    actions = {"action": features_of(root)["action"]}
    policy = learner(root, n_future_steps=0, output_features=actions)
    assert ("privileged_episodes is gone" in caplog.text) == edited
    assert policy.config.relative_dims == 0
    assert policy(batch_of(policy, root))[0].isfinite()


def test_a_frozen_encoder_refuses_images_that_are_changed(image_root: Path, tmp_path: Path):
    frozen = TINY | RECORDED | {"n_future_steps": 0}
    with pytest.raises(ValueError, match=r"image_transforms.enable is true, but must be false"):
        lerobot_train(image_root, tmp_path / "out", NEW | frozen, **CHANGED)


def fine_tuned(checkpoint: Path, root: Path, **changes: object) -> ObActPolicy:
    """A checkpoint that is about to learn from a dataset, as `lerobot-train --policy.path` opens
    it.
    """
    config = ObActConfig.from_pretrained(checkpoint)
    for name, value in changes.items():
        setattr(config, name, value)
    config.pretrained_path = checkpoint
    config.output_features = {"action": features_of(root)["action"]}
    meta = metadata(root)
    return ObActPolicy.from_pretrained(
        checkpoint, config=config, dataset_stats=meta.stats, dataset_meta=meta
    ).train()


def test_what_learned_actions_alone_goes_on_so_where_the_targets_path_is_known(
    hand_root: Path, tmp_path: Path
):
    learner(hand_root, forecast_weight=0.0).save_pretrained(tmp_path)
    for weight in (0.0, 1.0):
        policy = fine_tuned(tmp_path, hand_root, forecast_weight=weight)
        assert set(policy(batch_of(policy, hand_root))[1]) == {"action"}


def test_what_learned_to_forecast_is_not_trained_without(hand_root: Path, tmp_path: Path):
    learner(hand_root).save_pretrained(tmp_path)
    with pytest.raises(ValueError, match="learned to forecast the target"):
        fine_tuned(tmp_path, hand_root, forecast_weight=0.0)


# -- acting ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["obact_standard", "obact_two", "obact_contact"])
def test_a_checkpoint_that_ships_acts(name: str):
    policy = ObActPolicy.from_pretrained(SHIPPED_POLICY.with_name(name))
    assert policy.select_action(step(policy)).isfinite().all()
    assert policy.config.forecasts


@torch.no_grad()
def varied(**changes: object) -> ObActPolicy:
    """A policy whose draws differ."""
    policy = hand_policy(**{"n_action_steps": 1, "n_obs_steps": 9} | changes)
    for parameter in policy.model.parameters():
        parameter.add_(0.05 * torch.randn_like(parameter))
    return policy


def forecasting(**changes: object) -> ObActPolicy:
    """A policy whose draws differ, and which forecasts."""
    robot = Embodiment(palm_speed_m_s=0.5, capture="attach")
    return varied(encoder="eye", freeze_encoder=True, embodiment=robot, **changes)


def played(policy: ObActPolicy, rows: list[int], frames: int = 4) -> torch.Tensor:
    """The actions of some of 32 environments, ``(T, B, A)``."""
    policy.reset()
    seen = [step(policy, n=32, seed=i) for i in range(frames)]
    return torch.stack(
        [policy.select_action({key: x[rows] for key, x in batch.items()}) for batch in seen]
    )


def test_an_action_follows_from_what_was_seen_and_not_from_batch_order_interruption_or_chance():
    policy = varied()
    everyone = list(range(32))
    together = played(policy, everyone)
    torch.manual_seed(7)
    played(policy, [3], frames=2)  # an episode that is interrupted
    for rows in ([5], [2, 30], everyone[::-1]):
        torch.testing.assert_close(played(policy, rows), together[:, rows], atol=0, rtol=0)
    again = played(varied(), [5])
    torch.testing.assert_close(again, together[:, [5]], atol=0, rtol=0)


def test_every_frame_has_noise_of_its_own():
    policy = varied(n_obs_steps=1)
    batch = step(policy)
    first = policy.select_action(batch)
    second = policy.select_action(batch)
    assert (first - second).abs().max() > 1e-3


def test_frames_that_were_dropped_count_as_time_that_passed_also_between_chunks():
    policy = varied()
    times_s = (0.0, 0.1, 0.5)
    seen = [step(policy, seed=i) for i in range(3)]
    stamped = [at(time_s, batch) for time_s, batch in zip(times_s, seen, strict=True)]

    def acted(batches: list[dict], act=policy.select_action) -> torch.Tensor:
        policy.reset()
        return torch.stack([act(batch) for batch in batches])

    with_drops = acted(stamped)
    on_time = acted(seen)
    torch.testing.assert_close(with_drops[0], on_time[0])
    assert not torch.equal(with_drops[2], on_time[2])
    chunks = acted(stamped, policy.predict_action_chunk)
    torch.testing.assert_close(chunks[:, :, 0], with_drops)
    today = [batch | {"timestamp": batch["timestamp"].double() + 1.7e9} for batch in stamped]
    torch.testing.assert_close(acted(today), with_drops, atol=1e-4, rtol=0)


def test_a_frame_with_a_new_timestamp_counts_even_if_it_looks_like_the_one_before():
    policy = varied(n_action_steps=2)
    for i in range(4):
        policy.select_action(at(0.05 * i, step(policy)))
    assert list(policy._history.ticks) == [0, 1, 2, 3]


EGO = "observation.images.ego"


@pytest.mark.parametrize(
    ("key", "change", "said"),
    [
        (EGO, lambda x: 255 * x, r"float32 from .* to 25\d.*, but must be .* \[0, 1\]"),
        (EGO, lambda x: 2 * x - 1, r"float32 from -\d.* to \d.*, but must be .* \[0, 1\]"),
        (EGO, lambda x: (255 * x).byte(), r"uint8 from \d+ to 25\d, but must be"),
        (EGO, lambda x: x.movedim(1, -1), r"\(2, 32, 32, 3\), .* \(B, 3, 32, 32\)"),
        (EGO, lambda x: x[:1], r"observation\.state is of 2 environments, .* 1, as"),
        (EGO, lambda x: x.numpy(), r"numpy.ndarray'>, but must be a tensor"),
        ("observation.state", lambda x: None, r"missing, but must be a tensor of shape \(B, 18\)"),
        ("observation.state", lambda x: x[:, :5], r"\(2, 5\), but must be .* \(B, 18\)"),
    ],
)
def test_an_input_of_another_kind_than_in_training_is_refused(key: str, change, said: str):
    policy = varied()
    batch = step(policy)
    for act in (policy.select_action, policy.predict_action_chunk, policy.observe):
        with pytest.raises(ValueError, match=said):
            act(batch | {key: change(batch[key])})
    assert not policy._history.ticks, "nothing was noted"


def test_a_chunk_cannot_be_ready_before_it_is_asked_for():
    policy = varied()
    with pytest.raises(ValueError, match="inference_delay is -1, but must be 0 or more"):
        policy.predict_action_chunk(step(policy), inference_delay=-1)


def test_time_that_goes_back_asks_for_a_reset():
    policy = varied()
    policy.select_action(at(1.0, step(policy)))
    with pytest.raises(ValueError, match=r"0\.900 s after 1\.000 s.*policy\.reset\(\)"):
        policy.select_action(at(0.9, step(policy)))
    policy.reset()
    policy.select_action(at(0.9, step(policy)))


def test_a_window_reaches_back_over_frames_that_were_dropped():
    policy = varied()

    def later(first: int) -> torch.Tensor:
        policy.reset()
        policy.select_action(at(0.0, step(policy, seed=first)))
        return policy.select_action(at(0.35, step(policy, seed=9)))

    assert not torch.equal(later(1), later(2))


def set_clock(monkeypatch: pytest.MonkeyPatch, *times_s: float, then: Iterator[float]) -> None:
    """Let the wall clock say these times, one after the other."""
    clock = chain(times_s, then)
    monkeypatch.setattr("time.monotonic", lambda: next(clock))


@pytest.mark.parametrize("n_action_steps", [1, 2])
def test_how_long_a_server_takes_changes_no_chunk_where_the_world_waits(
    n_action_steps: int, monkeypatch: pytest.MonkeyPatch
):
    policy = varied(n_action_steps=n_action_steps)
    seen = [step(policy, seed=i) for i in range(4)]
    stamped = [at(0.05 * n_action_steps * i, batch) for i, batch in enumerate(seen)]

    def chunks(batches: list[dict], server_s: float) -> torch.Tensor:
        set_clock(monkeypatch, then=count(100.0, server_s))
        policy.reset()
        return torch.stack([policy.predict_action_chunk(batch) for batch in batches])

    prompt = chunks(seen, 0.05)
    assert torch.equal(chunks(seen, 0.2), prompt)
    assert torch.equal(chunks(stamped, 0.05), prompt)
    policy.real_time = True
    assert not torch.equal(chunks(seen, 0.2), chunks(seen, 0.05)), "a robot moves on"


def live(policy: ObActPolicy, seed: int) -> torch.Tensor:
    """A chunk as LeRobot's real-time chunking asks for it."""
    return policy.predict_action_chunk(
        step(policy, seed=seed), inference_delay=0, prev_chunk_left_over=None
    )


def test_frames_are_ticks_of_the_robots_clock_however_often_and_late_a_caller_asks(monkeypatch):
    policy = varied()
    ticks_0_0_1_2_and_3 = (100.0, 100.02, 100.06, 100.09, 100.16)
    set_clock(monkeypatch, *ticks_0_0_1_2_and_3, then=repeat(0.0))
    hurried = [live(policy, seed=i) for i in (0, 0, 1, 2, 3)]
    policy.reset()
    regular = [policy.predict_action_chunk(at(0.05 * i, step(policy, seed=i))) for i in range(4)]
    torch.testing.assert_close(torch.stack(hurried[1:]), torch.stack(regular))


def test_the_last_frame_of_the_episode_before_is_forgotten(monkeypatch):
    policy = varied()
    times_s = (100.0, 100.05, 110.0, 110.02, 110.07, 110.12, 0.0, 0.05)
    set_clock(monkeypatch, *times_s, then=repeat(0.0))
    for i in (8, 9):
        live(policy, seed=i)
    policy.reset()
    stale = [live(policy, seed=i) for i in (9, 9, 0, 1)]
    policy.reset()
    fresh = [live(policy, seed=i) for i in (0, 1)]
    torch.testing.assert_close(torch.stack(stale[2:]), torch.stack(fresh))


@pytest.mark.parametrize("shape", [(), (1,)], ids=["a scalar", "a vector"])
def test_rows_that_are_kept_act_as_with_those_that_are_dropped(shape: tuple[int, ...]):
    """The eye compares with the image before, and commands are under way."""
    robot = Embodiment(delay_frames=3, palm_speed_m_s=0.5, capture="attach")
    told = {"encoder": "eye", "freeze_encoder": True, "embodiment": robot}
    policy = varied(n_action_steps=2, horizon=4, **told)
    rows = np.array([0, 2])

    def actions(dropped_after: int) -> torch.Tensor:
        """Those of both rows in all frames."""
        policy.reset()
        found = []
        for i in range(6):
            batch = step(policy, n=3, seed=i)
            if i > dropped_after:
                batch = {key: values[rows] for key, values in batch.items()}
            batch["timestamp"] = torch.full(shape, 0.05 * i)
            action = policy.select_action(batch)
            found.append(action if i > dropped_after else action[rows])
            if i == dropped_after:
                assert policy.keep_rows(rows)
        return torch.stack(found)

    torch.testing.assert_close(actions(2), actions(9), rtol=0, atol=0)


def test_real_time_chunking_guides_no_chunk():
    policy = varied(horizon=4, rtc_config=RTCConfig(enabled=True))
    assert supports_rtc_inference(policy)
    alone = policy.predict_action_chunk(step(policy))
    policy.reset()
    after = policy.predict_action_chunk(step(policy), prev_chunk_left_over=torch.rand(2, 3, 18))
    torch.testing.assert_close(after, alone, rtol=0, atol=0)


def test_a_chunk_that_is_late_follows_from_the_palm_as_it_will_be(monkeypatch):
    """A hand that goes where it was told, and a chunk that is there two frames later, after which
    the next inference begins. Each further action follows from the palm as it will be by then, too.
    """
    policy = forecasting(horizon=6)
    step_m = policy.config.embodiment.step_m
    batch = step(policy)
    asked = []
    condition = policy._actor.condition

    def noting(forecast, palm, state):
        asked.append(palm.float())
        return condition(forecast, palm, state)

    monkeypatch.setattr(policy._actor, "condition", noting)
    goals = {}
    palms = []
    for frame in range(8):
        palm = batch["observation.state"][:, :3].clone()
        palms.append(palm)
        if frame % 2 == 0:
            chunk = policy.predict_action_chunk(at(0.05 * frame, batch), 2)
            goals |= {frame + i: chunk[:, i, :3] for i in range(2, 6)}
        else:
            policy.observe(at(0.05 * frame, batch))
        if frame == 0:
            assert (chunk[:, 0] == chunk[:, 2]).all(), "what is past stands still"
        if frame in goals:
            batch["observation.state"][:, :3] = stepped(palm, goals[frame], step_m)
    third = asked[8:12]  # of each chunk, the last four of six actions are decided
    torch.testing.assert_close(third[:2], palms[6:], atol=1e-5, rtol=0)
    assert (palms[6] - palms[4]).norm(dim=-1).min() > step_m


def test_each_action_of_a_chunk_follows_from_the_forecast_as_of_its_frame(monkeypatch):
    policy = forecasting(horizon=4)
    shifts = []

    def later(forecast, frames):
        shifts.append(frames)
        return forecast

    monkeypatch.setattr("lerobot_policy_obact.forecaster.Forecast.later", later)
    policy.predict_action_chunk(step(policy), 1)
    assert shifts == [1, 2, 3]
    policy.select_action(step(policy, seed=1))
    assert shifts[3:] == [0], "alone, an action needs one decision"


def test_while_a_chunk_is_awaited_the_last_one_goes_on():
    policy = forecasting(horizon=8, n_action_steps=6, inference_delay=3)
    batch = step(policy)
    actions = []
    for i in range(12):
        batch["observation.state"] = batch["observation.state"] + 0.01
        actions.append(policy.select_action(at(0.05 * i, batch)))
    first = torch.stack(actions[:6])
    second = torch.stack(actions[6:])
    assert (first[:3] == first[3]).all(), "nothing was commanded before"
    assert (second[:3] != second[3]).any(-1).all(), "what goes on is not what follows"
    assert (second[0] != second[1]).any()
    assert (second[1] != second[2]).any(), "each follows from a decision of its own"


def along_x(places_m: list[float]) -> torch.Tensor:
    """Places on the x axis, (1, T, 3)."""
    return torch.tensor(places_m)[None, :, None] * torch.tensor([1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("ticks", "palms", "told", "due"),
    [
        ([0, 1, 2, 3], [0.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.2], 0.125),
        ([0, 1, 2, 3], [0.1, 0.1, 0.1, 0.1], [0.2, 0.2, 0.2], 0.1),
        ([0, 1, 2, 3], [0.1, 0.125, 0.15, 0.175], [0.2, 0.2, 0.3], 0.2),
        ([0, 3], [0.1, 0.15], [0.2, 0.2, 0.3], 0.175),
        ([0, 3], [0.1, 0.11], [0.2, 0.2, 0.3], 0.11),
    ],
    ids=[
        "it hovered where it was told",
        "it is held",
        "it goes where it was told",
        "it went where it was told while nobody looked",
        "it was held while nobody looked",
    ],
)
def test_commands_on_their_way_count_unless_the_hand_is_held(
    ticks: list, palms: list, told: list, due: float
):
    commands = CommandBuffer(Embodiment(palm_speed_m_s=0.5, fps=20, delay_frames=1))
    commands.give(along_x(told), 0, 0)
    expected = commands.expected_palm(along_x(palms), ticks, 0)
    torch.testing.assert_close(expected, along_x([due])[:, 0], atol=1e-3, rtol=0)


@pytest.mark.parametrize("rate_hz", [10, 20, 25, 40, 50, 60])
def test_commands_on_their_way_count_at_any_rate_of_the_loop(rate_hz: int):
    """Of a hand that goes where it was told, three ticks of 2.5 cm late."""
    robot = Embodiment(palm_speed_m_s=0.5, fps=20, delay_frames=3)
    commands = CommandBuffer(robot)
    history = ObservationHistory(12, robot.fps)
    leads = []
    for frame in range(24):
        now_s = frame / rate_hz
        way = along_x([0.5 * max(0.0, now_s - robot.delay_frames / robot.fps)])
        history.add(torch.zeros(1, 1, 5), way[:, 0], now_s)
        expected = commands.expected_palm(history.frames().palm, history.ticks, 0)
        leads.append(float((expected - way[:, 0])[0, 0]))
        commands.give(along_x([9.0]), history.ticks[-1], 0)
    assert leads[12:] == pytest.approx([0.075] * 12, abs=1e-3)


def test_the_first_chunk_is_under_way_at_once_if_nothing_awaits_it():
    """LeRobot executes what `select_action` returns, from its first action on."""
    commands = CommandBuffer(Embodiment(palm_speed_m_s=0.5, fps=20))
    commands.give(along_x([9.0] * 6), 0, 3)
    expected = commands.expected_palm(along_x([0.0, 0.025]), [0, 1], 3)
    torch.testing.assert_close(expected, along_x([0.1])[:, 0], atol=1e-3, rtol=0)


def test_what_goes_on_while_a_chunk_is_awaited_is_for_the_same_ticks_if_nobody_looked_meanwhile():
    policy = forecasting(horizon=6)
    first = policy.predict_action_chunk(at(0.0, step(policy)), 0)
    second = policy.predict_action_chunk(at(0.15, step(policy, seed=1)), 2)
    torch.testing.assert_close(second[:, :2], first[:, 3:5], atol=0, rtol=0)


def test_recorded_actions_follow_from_where_the_palm_is_as_in_training():
    """Whatever is on its way to a hand that acts on commands two frames late."""
    policy = varied(embodiment=Embodiment(palm_speed_m_s=0.5, delay_frames=2))
    seen = [step(policy, seed=i) for i in range(4)]
    chunks = []
    for before, delay in ((policy.select_action, 0), (policy.observe, 0), (policy.observe, 2)):
        policy.reset()
        for i, batch in enumerate(seen[:3]):
            before(at(0.05 * i, batch))
        chunks.append(policy.predict_action_chunk(at(0.15, seen[3]), delay))
    assert torch.equal(chunks[0], chunks[1])
    assert torch.equal(chunks[0], chunks[2])


def test_a_decision_tells_what_it_saw_expects_and_attends_to():
    policy = varied()
    for i in range(3):
        policy.select_action(step(policy, seed=i))
    decision = policy.decision
    assert decision.sighted.shape == (2, 1, 3)
    assert decision.forecast.shape == (2, len(decision.ahead_s), 3)
    assert decision.intercept.shape == (2, 3)
    assert decision.attention.shape == (2, 4, 3), "of three frames observed, in four readouts"
    torch.testing.assert_close(decision.attention.sum(-1), torch.ones(2, 4), check_dtype=False)


def test_another_number_of_environments_needs_a_reset():
    policy = hand_policy(n_action_steps=1)
    policy.select_action(step(policy, n=2))
    with pytest.raises(ValueError, match="from 2 to 3 environments"):
        policy.select_action(step(policy, n=3))
    policy.reset()
    assert policy.select_action(step(policy, n=3)).shape == (3, 18)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("encoder", "camera", "eye, conv"),
        ("head", "arm", "diffusion, gr00t"),
        ("head_options", {"depth": 3}, "of width, n_steps, n_draws, closing_quantile"),
        ("n_obs_steps", 0, "1 or more"),
        ("relative_dims", 4, "0 to 3"),
        ("n_action_steps", 9, "1 to 4"),
        ("delayed_share", -0.5, "0 to 1"),
        ("virtual_share", 1.5, "0 to 1"),
        ("normalization_mapping", {"STATE": NormalizationMode.MEAN_STD}, "IDENTITY"),
        ("use_amp", True, "false"),
        ("embodiment", Embodiment(calibration={"observation.images.ego": [0.0, 1.0]}), "9 numbers"),
    ],
)
def test_a_wrong_option_is_named_with_what_is_allowed(name: str, value: object, allowed: str):
    with pytest.raises(ParsingError, match=f"{name}.* {allowed}"):
        hand_policy(**{name: value})


def test_a_wrong_option_of_the_head_is_named_with_what_is_allowed():
    with pytest.raises(ValueError, match=r"head_options.n_draws is 0, but must be 1 to 100"):
        hand_policy(head_options={"n_draws": 0})


@pytest.mark.parametrize("option", ["n_hands=0", "embodiment.delay_frames=-3", "embodiment.fps=0"])
def test_the_command_line_of_lerobot_says_what_is_wrong_with_an_option(option: str):
    name, value = option.split("=")
    with pytest.raises(ParsingError, match=f"{name} is {value}.*, but must be"):
        draccus.parse(ObActConfig, args=[f"--{option}"])


ALONE = """if True:
    import sys
    sys.modules["dynahoi_lerobot"] = None  # whoever imports it fails
    import torch
    from lerobot.datasets import LeRobotDatasetMetadata
    from lerobot_policy_obact import ObActPolicy
    checkpoint, root, out = sys.argv[1:]
    policy, seen = ObActPolicy.from_pretrained(checkpoint), torch.load(f"{out}/seen.pt")
    torch.save(torch.stack([policy.select_action(batch) for batch in seen]), f"{out}/actions.pt")
    training = {"teacher", "losses", "windows", "dataset"}
    ours = [name for name in sys.modules if name.startswith("lerobot_policy_obact")]
    assert not training & {name.split(".")[-1] for name in ours}
    meta = LeRobotDatasetMetadata("local/tiny", root=root)
    given = {"dataset_stats": meta.stats, "dataset_meta": meta, "load_pretrained": False}
    policy = ObActPolicy(policy.config, **given).train()
    loss, told = policy(torch.load(f"{out}/batch.pt"))
    loss.backward()
    assert {"forecast", "action", "closed_loop"} <= set(told)
    assert policy.select_action(seen[0]).isfinite().all()
"""


def test_another_process_without_the_core_acts_the_same_and_trains(hand_root: Path, tmp_path: Path):
    """What labels decisions is imported for training alone, and nothing of the core at all."""
    policy = learner(hand_root, n_action_steps=1).eval()
    policy.save_pretrained(tmp_path / "checkpoint")
    seen = [step(policy, n=2, seed=i) for i in range(3)]
    torch.save(seen, tmp_path / "seen.pt")
    torch.save(batch_of(policy, hand_root), tmp_path / "batch.pt")
    python("-c", ALONE, tmp_path / "checkpoint", hand_root, tmp_path)
    actions = torch.stack([policy.select_action(batch) for batch in seen])
    torch.testing.assert_close(torch.load(tmp_path / "actions.pt"), actions, atol=1e-4, rtol=0)


def test_where_lerobot_has_merged_only_actions_are_learned(hand_root: Path, tmp_path: Path, caplog):
    root = tmp_path / "merged"
    sources = [LeRobotDataset("local/x", root=hand_root), LeRobotDataset("local/y", root=hand_root)]
    merge_datasets(sources, "local/merged", root)
    meta = LeRobotDatasetMetadata("local/merged", root=root)
    found = dataset.embodiment_of(meta, ["observation.images.ego"])
    assert found.capture == ""
    assert "only actions are learned" in caplog.text


@pytest.mark.parametrize(("forecast_weight", "frames"), [(1.0, 37), (0.0, 13)])
def test_it_acts_on_as_many_frames_as_it_learns_from(
    forecast_weight: float, frames: int, hand_root: Path
):
    """Recorded actions are learned in the current frame alone, also where frames to come are
    shown.
    """
    policy = learner(hand_root, forecast_weight=forecast_weight, n_obs_steps=13, n_future_steps=24)
    policy.reset()
    for seed in range(40):
        policy.select_action(step(policy, seed=seed))
    assert policy.decision.attention.shape[-1] == frames
