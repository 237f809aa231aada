"""The simulated hand behind LeRobot's robot interface: its clock, its episodes, and LeRobot's own
programs on it.
"""

import asyncio
import socket
from dataclasses import dataclass
from itertools import batched
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace
from unittest.mock import MagicMock

import aiohttp
import numpy as np
import pytest
from lerobot.processor import make_default_processors
from lerobot.robots import make_robot_from_config
from lerobot.rollout.strategies import episodic
from lerobot.scripts.lerobot_record import record_loop
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot_robot_dynahoi import (
    DynahoiBrowserConfig,
    DynahoiExpertConfig,
    DynahoiRobot,
    DynahoiRobotConfig,
)

from dynahoi_lerobot.evaluate.results import Results, read_results

FRAME_S = 0.05


@dataclass
class Clock:
    """A clock that moves when told."""

    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(autouse=True)
def _disconnected():
    yield
    for robot in list(DynahoiRobot.connected):
        robot.disconnect()


def robot_on(clock: Clock, **options) -> DynahoiRobot:
    robot = DynahoiRobot(
        DynahoiRobotConfig(**{"task": "constant", "image_size": 32} | options), clock
    )
    robot.connect()
    return robot


def catch(robot: DynahoiRobot, clock: Clock, jitter_s: float = 0.0, thinking_s: float = 0.0) -> int:
    """Let the expert move the robot until its episode is over; return the number of actions.

    It observes at times off by up to ``jitter_s``, and acts ``thinking_s`` later on what it saw.
    """
    expert = make_teleoperator_from_config(DynahoiExpertConfig())
    expert.connect()
    rng = np.random.default_rng(0)
    begun_s = clock.now_s
    for k in range(400):
        clock.now_s = begun_s + k * FRAME_S + (rng.uniform(-jitter_s, jitter_s) if k else 0.0)
        robot.get_observation()
        if robot.world.finished:
            return k
        action = expert.get_action()
        clock.now_s += thinking_s
        robot.send_action(action)
    raise AssertionError("the episode does not end")


@pytest.mark.parametrize(("jitter_s", "thinking_s"), [(0.02, 0.0), (0.004, 0.04)])
def test_the_expert_catches_by_the_clock_and_without_it(jitter_s: float, thinking_s: float):
    clock = Clock()
    timed = robot_on(clock)
    actions = catch(timed, clock, jitter_s, thinking_s)
    assert timed.world.finished.success
    assert timed.world.missed == 0, "actions that are less than half a frame off are not late"
    stepped = robot_on(Clock(), realtime=False)
    assert catch(stepped, Clock()) == actions
    np.testing.assert_array_equal(stepped.world.finished.state, timed.world.finished.state)


def test_the_world_moves_whether_or_not_an_action_comes():
    clock = Clock()
    robot = robot_on(clock)
    before = robot.get_observation()
    clock.now_s += 5.0
    assert np.array_equal(before["ego"], robot.get_observation()["ego"]), (
        "it waits for the first action"
    )
    hold = {name: before[name] for name in robot.action_features}
    robot.send_action(hold)
    clock.now_s += 10 * FRAME_S
    robot.send_action(hold)
    assert not np.array_equal(before["ego"], robot.get_observation()["ego"])
    clock.now_s += 1000 * FRAME_S
    robot.send_action(hold)
    episode = robot.world.finished
    assert episode is not None
    assert not episode.success
    assert robot.world.missed == int(episode.phase[:, 1].sum()) - (episode.phase[:10, 1].sum() > 0)


def test_a_late_action_takes_effect_late():
    clock = Clock()
    robot = robot_on(clock)
    hold = {name: robot.get_observation()[name] for name in robot.action_features}
    robot.send_action(hold)
    window = robot.world.spec.window_frames
    clock.now_s += (window + 10) * FRAME_S
    robot.send_action(hold | {"palm_z.pos": 0.2})
    still = robot.get_observation()["palm_z.pos"]
    clock.now_s += 4 * FRAME_S
    moved = robot.get_observation()["palm_z.pos"]
    assert abs(still) < 1e-3
    assert moved > 0.05, "four frames at 0.5 m/s"


def test_the_next_episode_begins_when_lerobot_comes_back_from_a_pause():
    clock = Clock()
    robot = robot_on(clock)
    first = robot.world.spec.seed
    catch(robot, clock)
    clock.now_s += FRAME_S
    robot.send_action(dict.fromkeys(robot.action_features, 0.0))
    robot.get_observation()
    assert robot.world.spec.seed == first, (
        "what LeRobot does in its reset phase does not begin an episode"
    )
    clock.now_s += 1.0
    robot.get_observation()
    assert robot.world.spec.seed != first
    assert robot.world.finished is None


def test_every_episode_that_lerobot_records_is_one_of_the_worlds_without_a_pause_between_them():
    """As with streaming encoding, which saves an episode at once, and in one recorded again."""
    robot = robot_on(Clock(), realtime=False)
    expert = make_teleoperator_from_config(DynahoiExpertConfig())
    expert.connect()
    identity = {
        f"{name}_processor": pipeline
        for name, pipeline in zip(
            ("teleop_action", "robot_action", "robot_observation"),
            make_default_processors(),
            strict=True,
        )
    }

    def recorded(dataset: object, frames: int) -> int:
        """Let LeRobot record or reset for some frames; return the number of the episode then."""
        events = {"exit_early": False}
        left = iter(range(frames))
        robot.send_action = lambda action: (
            events.update(exit_early=next(left, None) is None)
            or (DynahoiRobot.send_action(robot, action))
        )
        record_loop(
            robot, events, 1000, **identity, dataset=dataset, teleop=expert, control_time_s=9
        )
        return robot.world.spec.seed

    data = SimpleNamespace(fps=1000, features={}, add_frame=lambda frame: None)
    first = recorded(data, 3)
    assert recorded(None, 3) == first, "what LeRobot does in its reset phase begins no episode"
    again = recorded(data, 3)
    assert again != first, "in the middle of a flight"
    assert recorded(data, 200) not in (first, again)
    assert robot.world.finished
    last = robot.world.spec.seed
    assert recorded(None, 3) == last
    assert recorded(data, 3) != last
    assert not robot.world.finished


def test_every_episode_of_an_episodic_rollout_is_one_of_the_worlds(monkeypatch):
    """Also where LeRobot lets no time pass without an action between two of them."""
    robot = robot_on(Clock(), realtime=False)
    acts = lambda *args: robot.send_action(dict.fromkeys(robot.action_features, 0.0))  # noqa: E731
    monkeypatch.setattr(episodic, "send_next_action", acts)
    monkeypatch.setattr(episodic, "build_dataset_frame", lambda *args, **kwargs: {})
    numbers = []

    class Strategy(episodic.EpisodicStrategy):
        def __init__(self) -> None:
            self.config = SimpleNamespace(reset_to_initial_position=True)
            self._engine = MagicMock()
            self._interpolator = MagicMock(get_control_interval=lambda fps: 0.0)
            self._events = dict.fromkeys(
                ("stop_recording", "exit_early", "rerecord_episode"), False
            )

        def _process_observation_and_notify(self, *args: object) -> dict:
            return {}

        def _handle_warmup(self, *args: object) -> bool:
            return False

        def _log_telemetry(self, *args: object) -> None:
            numbers.append(robot.world.spec.seed)
            self._events["exit_early"] = len(numbers) % 3 == 0
            self._events["rerecord_episode"] = len(numbers) == 6

        def _return_to_initial_position(self, **kwargs: object) -> None:
            robot.get_observation()
            acts()

    dataset = {"episode_time_s": 9, "reset_time_s": 0, "num_episodes": 3, "single_task": "catch"}
    told = SimpleNamespace(
        dataset=SimpleNamespace(**dataset), fps=1000, play_sounds=False, display_data=False,
        display_mode="", display_compressed_images=False, use_torch_compile=False,
    )  # fmt: skip
    data = SimpleNamespace(dataset=MagicMock(), dataset_features={})
    runtime = SimpleNamespace(cfg=told, shutdown_event=Event())
    hardware = SimpleNamespace(robot_wrapper=robot, teleop=None)
    monkeypatch.setattr(episodic, "VideoEncodingManager", MagicMock())
    context = SimpleNamespace(runtime=runtime, hardware=hardware, data=data, processors=None)
    Strategy().run(context)
    episodes = [set(group) for group in batched(numbers, 3)]
    assert [len(group) for group in episodes] == [1] * 4, "one of three is recorded again"
    assert len(set.union(*episodes)) == 4


def test_a_paused_lerobot_that_holds_the_hand_waits_in_the_first_frame_of_the_next_episode():
    clock = Clock()
    robot = robot_on(clock)
    first = robot.world.spec.seed
    catch(robot, clock)
    keep_still(robot, clock, 40)
    assert robot.world.spec.seed != first
    assert robot.world.batch.frame[0] == 0
    catch(robot, clock)
    assert robot.world.finished.success


def test_the_next_episode_begins_after_restart_s_and_results_go_on_where_they_stopped(
    tmp_path: Path,
):
    clock = Clock()
    robot = robot_on(clock, restart_s=1.0, results_dir=tmp_path)
    first = robot.world.spec.seed
    catch(robot, clock)
    keep_still(robot, clock, 25)
    assert robot.world.spec.seed != first
    assert read_results(tmp_path).seeds == {first}
    robot.disconnect()
    again = robot_on(Clock(), results_dir=tmp_path)
    assert again.world.spec.seed != first
    again.disconnect()
    with pytest.raises(FileExistsError):
        robot_on(Clock(), results_dir=tmp_path, capture="contact")


def keep_still(robot: DynahoiRobot, clock: Clock, frames: int) -> None:
    """Send the same dict again and again, as a paused LeRobot does."""
    held = dict.fromkeys(robot.action_features, 0.0)
    for _ in range(frames):
        clock.now_s += FRAME_S
        robot.get_observation()
        robot.send_action(held)


def test_writing_the_results_of_an_episode_is_no_pause_of_lerobots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    clock = Clock()
    write = Results.write

    def write_slowly(results: Results) -> None:
        clock.now_s += 0.4
        write(results)

    monkeypatch.setattr(Results, "write", write_slowly)
    robot = robot_on(clock, results_dir=tmp_path / "results")
    first = robot.world.spec.seed
    catch(robot, clock)
    robot.send_action(dict.fromkeys(robot.action_features, 0.0))
    clock.now_s += FRAME_S
    robot.get_observation()
    assert robot.world.spec.seed == first


def test_a_person_at_the_page_moves_the_robot():
    browser = make_teleoperator_from_config(DynahoiBrowserConfig(port=0))
    seen = []

    async def steer():
        while not browser.server.address:
            await asyncio.sleep(0.01)
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(browser.server.address + "play") as page,
        ):
            async for message in page:
                seen.append(message)
                await page.send_json({"x": 0, "y": 1, "depth": 0, "closed": 1})

    person = Thread(target=asyncio.run, args=(steer(),), daemon=True)
    person.start()
    browser.connect()
    robot = robot_on(Clock(), realtime=False)
    open_hand = robot.get_observation()
    for _ in range(1000):
        robot.send_action(browser.get_action())
        if robot.world.finished:
            break
    told = robot.get_observation()
    browser.disconnect()
    person.join(5)
    assert told["palm_z.pos"] > open_hand["palm_z.pos"] + 0.1, "up, where the pointer was"
    assert told["index_base.pos"] != open_hand["index_base.pos"]
    facts, image = (
        next(m for m in seen if m.type == kind)
        for kind in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY)
    )
    assert facts.json()["frame"]["window_s"] > 0
    assert image.data[:2] == b"\xff\xd8", "a JPEG"


def test_an_address_in_use_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=str(port)):
            make_teleoperator_from_config(DynahoiBrowserConfig(port=port)).connect()


def test_lerobot_makes_it_from_its_config_and_unknown_names_are_refused_in_one_sentence():
    robot = make_robot_from_config(DynahoiRobotConfig(image_size=32, views=["side"]))
    assert robot.observation_features["side"] == (32, 32, 3)
    assert set(robot.action_features) < set(robot.observation_features)
    with pytest.raises(DeviceNotConnectedError):
        robot.get_observation()
    for name in ("split", "capture", "control_class", "hand", "task", "image_size"):
        with pytest.raises(ValueError, match=r"^[^\n]+$"):
            DynahoiRobotConfig(**{name: 0 if name == "image_size" else "x"})


def test_a_bad_action_is_refused_and_nothing_is_lost():
    clock = Clock()
    robot = robot_on(clock)
    good = dict.fromkeys(robot.action_features, 0.0)
    for bad in (
        {**good, "palm_x.pos": float("nan")},
        {name: 0.0 for name in good if name != "palm_x.pos"},
    ):
        with pytest.raises(ValueError, match=r"palm_x|finite"):
            robot.send_action(bad)
    catch(robot, clock)
    assert robot.world.finished.success
