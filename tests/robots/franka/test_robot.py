"""The LeRobot robot on a fake arm and hand: features, guarded actions, faults, no late motion."""

import importlib.util
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import draccus
import numpy as np
import pytest
import torch
from hand_fakes import FakeHand
from lerobot.robots import RobotConfig, make_robot_from_config
from robot_fakes import START, refused

from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka import robot as module
from uniforce_robots.franka.arm import Gains
from uniforce_robots.franka.robot import (
    RETURN_MOTIONS,
    STRATEGIES,
    allow_return_motion,
    forbid_return_motion,
)
from uniforce_robots.sensors import UniforceTactileCameraConfig
from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError, StaleSensorError
from uniforce_robots.sensors.plain_camera import FROZEN_AFTER, PlainCamera
from uniforce_vtla.errors import ContractError, RobotError, SensorError
from uniforce_vtla.keys import AXES


@pytest.fixture
def hand():
    return FakeHand()


@pytest.fixture
def robot(arm, hand, tmp_path, monkeypatch, patient):
    monkeypatch.setattr(module, "make_backend", lambda config: (arm, hand))
    robot = UniforceFranka(
        UniforceFrankaConfig(id="test", calibration_dir=tmp_path, stream=patient)
    )
    yield robot
    robot.disconnect()
    assert not [t for t in threading.enumerate() if t.name in ("arm-stream", "hand")], (
        "a thread is left"
    )


def action(dx=0.0, width=0.08):
    return dict(zip(AXES, [START.position_m[0] + dx, 0.0, 0.3, 0.0, width], strict=True))


@pytest.fixture
def moving(robot):
    """A robot that has been sent its first action."""
    robot.connect()
    robot.send_action(action())
    return robot


def test_features_are_the_five_axes(robot):
    assert list(robot.observation_features) == list(AXES) == list(robot.action_features)
    assert robot.name == "uniforce_franka" and robot.is_calibrated and not robot.is_connected


def test_observation_and_action_go_through(robot, arm, eventually):
    robot.connect()
    assert robot.get_observation() == pytest.approx(action())
    sent = robot.send_action(action(0.005, 0.03))
    assert sent["x.pos"] == pytest.approx(0.455)
    assert sent["width.pos"] == pytest.approx(0.07), "0.1 m/s over 0.1 s"
    eventually(lambda: bool(arm.targets) and abs(arm.targets[-1][1][0, 3] - 0.455) < 1e-9)
    np.testing.assert_allclose(arm.targets[-1][1][:3, :3], START.ee_to_base()[:3, :3], atol=1e-12)


BAD = [  # whatever else a number may not be: the attack on the guards
    *({**action(), "yaw.pos": bad} for bad in (torch.zeros(5), np.zeros(2))),
    *(None, [0.45, 0, 0.3, 0, 0.08], "home", 3),
]


@pytest.mark.parametrize("bad", BAD, ids=str)
def test_whatever_is_no_action_stops_the_robot_until_it_recovers(moving, arm, eventually, bad):
    with pytest.raises(RobotError) as caught:
        moving.send_action(bad)
    assert caught.value.fault == "action"
    eventually(lambda: bool(arm.stopped_at))
    count = len(arm.targets)
    with pytest.raises(RobotError) as latched:
        moving.send_action(action())
    assert latched.value is caught.value
    assert len(arm.targets) == count and moving.is_connected, "its data can still be kept"
    moving.recover()
    moving.send_action(action())


def test_a_dropped_robot_lets_go_and_waits_for_no_thread(moving, arm, monkeypatch, eventually):
    joined = []
    monkeypatch.setattr(
        threading.Thread, "join", lambda thread, timeout=None: joined.append(thread.name)
    )
    # by the collector, perhaps inside Thread.start: what joins there waits for itself
    moving.__del__()
    eventually(lambda: bool(arm.stopped_at))
    monkeypatch.undo()
    assert joined == [] and not moving.is_connected


def test_numbers_of_any_kind_are_taken(robot):
    robot.connect()
    kinds = {
        "x.pos": torch.tensor(0.455),
        "y.pos": np.float32(0),
        "z.pos": np.array(0.3),
        "yaw.pos": 0,
    }
    sent = robot.send_action({**action(), **kinds, "something.pos": 1.0})
    assert sent["x.pos"] == pytest.approx(0.455) and set(sent) == set(AXES)


def test_ctrl_c_in_an_action_lets_the_arm_rest(robot, arm, eventually, monkeypatch):
    robot.connect()
    arm.follows = False
    robot.send_action(action(0.01))
    eventually(lambda: bool(arm.targets) and abs(arm.targets[-1][1][0, 3] - 0.46) < 1e-9)
    with monkeypatch.context() as patch:
        patch.setattr(robot.guards, "_finite", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            robot.send_action(action())
    eventually(lambda: abs(arm.targets[-1][1][0, 3] - 0.45) < 1e-9)


def test_no_call_of_a_loop_waits_for_a_client_that_blocks(moving, arm):
    arm.blocks_s = 2.0
    time.sleep(0.1)
    begun = time.monotonic()
    with pytest.raises(RobotError):
        moving.send_action({**action(), "x.pos": None})
    assert time.monotonic() - begun < 0.5
    arm.blocks_s = 0.0


def test_a_hand_that_does_not_answer_leaves_nothing_behind(robot, arm, hand):
    hand.fault = RobotError("no hand", "connection")
    with pytest.raises(RobotError, match="no hand"):
        robot.connect()
    assert arm.closed and not robot.is_connected


def test_after_disconnect_nothing_moves(moving, arm):
    moving.disconnect()
    moving.disconnect()
    count = len(arm.targets)
    with refused("ended"):
        moving.send_action(action())
    assert len(arm.targets) == count and arm.closed and arm.stopped_at


def test_connecting_twice_is_refused(robot):
    robot.connect()
    with pytest.raises(RobotError, match="Disconnect first"):
        robot.connect()
    assert robot.is_connected


def test_lerobots_rollout_does_not_lead_the_arm_back(monkeypatch):
    """On its own copy of LeRobot's module: another test's robot may have changed the loaded one."""
    pytest.importorskip(STRATEGIES, reason="this LeRobot has no rollout strategies")
    spec = importlib.util.find_spec(STRATEGIES)
    strategies = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, STRATEGIES, strategies)
    spec.loader.exec_module(strategies)
    sent = []

    class Hardware:
        class robot_wrapper:  # noqa: N801
            get_observation = staticmethod(lambda: action())
            send_action = staticmethod(sent.append)

        initial_position = action(0.1)

    strategy = strategies.RolloutStrategy
    (name,) = (name for name in RETURN_MOTIONS if hasattr(strategy, name))
    getattr(strategy, name)(Hardware, duration_s=0.04)
    assert sent, "LeRobot's own would have moved: if it no longer does, forbid_return_motion can go"
    sent.clear()
    assert forbid_return_motion() and forbid_return_motion()
    getattr(strategy, name)(Hardware, duration_s=0.04)
    assert not sent
    allow_return_motion()
    getattr(strategy, name)(Hardware, duration_s=0.04)
    assert sent, "other robots may return"


def test_a_rollout_that_calls_its_return_motion_otherwise_is_refused(
    robot: UniforceFranka, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = SimpleNamespace(RolloutStrategy=type("RolloutStrategy", (), {}))
    monkeypatch.setitem(sys.modules, STRATEGIES, loaded)
    with pytest.raises(ContractError, match=r"return_to_initial_position.*neither"):
        robot.connect()
    assert not robot.is_connected


@pytest.mark.parametrize("name", RETURN_MOTIONS)
def test_no_arm_is_led_back_while_a_robot_is_connected(
    name: str, robot: UniforceFranka, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    motion = {name: staticmethod(lambda: "moves")}
    strategy = type("RolloutStrategy", (), motion)
    monkeypatch.setitem(sys.modules, STRATEGIES, SimpleNamespace(RolloutStrategy=strategy))
    with UniforceFranka(UniforceFrankaConfig(id="other", calibration_dir=tmp_path)) as other:
        robot.connect()
        other.disconnect()
        assert getattr(strategy, name)() is False
    robot.disconnect()
    assert getattr(strategy, name)() == "moves"


@dataclass
class Program:
    """How LeRobot's commands hold a robot's config."""

    robot: RobotConfig


def test_lerobot_parses_nested_settings_and_builds_it(tmp_path):
    words = {"type": "uniforce_franka", "calibration_dir": str(tmp_path), "guards.step_m": "0.03"}
    words |= {"gains.clip_m": "[0.01,0.01,0.02]", "gains.stiffness_N_m": "[200,200,200]"}
    config = draccus.parse(
        Program, args=[f"--robot.{key}={value}" for key, value in words.items()]
    ).robot
    assert isinstance(config, UniforceFrankaConfig)
    assert config.guards.step_m == 0.03
    assert config.gains == Gains((200, 200, 200), clip_m=(0.01, 0.01, 0.02))
    assert isinstance(make_robot_from_config(config), UniforceFranka)


class BrokenCamera:
    """As LeRobot's cameras are; ``error`` is raised, ``image`` given, whatever they are."""

    height = 4
    width = 6

    def __init__(self):
        self.error = None
        self.image = np.zeros((4, 6, 3), np.uint8)
        self.latest_timestamp = 0.0
        self.is_connected = False

    def connect(self):
        if self.error is not None:
            raise self.error
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def read_latest(self, max_age_ms):
        if self.error is not None:
            raise self.error
        return self.image


@pytest.fixture
def camera(robot):
    camera = BrokenCamera()
    robot.cameras = {"front": camera}
    return camera


ERRORS = {SensorError("frozen"): SensorError, TimeoutError("old"): StaleSensorError}
ERRORS |= dict.fromkeys(
    (RuntimeError("thread"), ConnectionError("gone"), KeyError("x")), LostSensorError
)
IMAGES = [
    None,
    "text",
    np.zeros((4, 6), np.uint8),
    np.zeros((4, 6, 3), np.float32),
    np.zeros((6, 4, 3), np.uint8),
]


@pytest.mark.parametrize(
    "broken, kind", [*ERRORS.items(), *((image, SensorError) for image in IMAGES)]
)
def test_a_sensor_that_is_not_well_stops_the_arm_and_is_counted(
    robot, camera, arm, eventually, broken, kind
):
    robot.connect()
    robot.send_action(action())
    assert robot.get_observation()["front"].shape == (4, 6, 3)
    good = camera.image
    camera.error, camera.image = (broken, good) if isinstance(broken, Exception) else (None, broken)
    with pytest.raises(kind):
        robot.get_observation()
    eventually(lambda: bool(arm.stopped_at))
    assert robot.guard_counts["sensor"] == 1
    with refused("sensor"):
        robot.send_action(action())
    robot.recover()
    camera.error = None
    camera.image = good
    robot.send_action(robot.get_observation())


def test_a_camera_that_repeats_itself_stops_the_arm(robot, camera, arm, eventually):
    robot.connect()
    robot.send_action(action())
    with pytest.raises(FrozenSensorError, match="front"):
        for _ in range(FROZEN_AFTER + 2):
            camera.latest_timestamp += 1 / 30
            robot.get_observation()
    eventually(lambda: bool(arm.stopped_at))


def test_a_cameras_pictures_are_stamped_and_counted_and_one_without_stamps_is_refused():
    camera = BrokenCamera()
    seen = []
    plain = PlainCamera("front", camera)
    for camera.latest_timestamp in (1.0, 1.0, 2.0):
        picture = plain.picture()
        seen.append((picture.index, picture.time_s))
    assert seen == [(0, 1.0), (0, 1.0), (1, 2.0)]
    with pytest.raises(ContractError, match="latest_timestamp"):
        PlainCamera("front", object())


def test_a_camera_that_cannot_be_connected_is_named(robot, camera, arm):
    camera.error = KeyError("device")
    with pytest.raises(SensorError, match="front: expected a camera that connects"):
        robot.connect()
    assert arm.closed and not robot.is_connected


def test_references_need_an_open_hand(tmp_path, arm, hand, monkeypatch):
    monkeypatch.setattr(module, "make_backend", lambda config: (arm, hand))
    finger = UniforceTactileCameraConfig(
        source="http://127.0.0.1:9", finger="left", sensor="gelsight"
    )
    config = UniforceFrankaConfig(
        id="test", calibration_dir=tmp_path, cameras={"tactile_left": finger}
    )
    robot = UniforceFranka(config)
    shapes = {
        name: shape
        for name, shape in robot.observation_features.items()
        if isinstance(shape, tuple)
    }
    assert shapes == {"tactile_left": (480, 640, 3), "tactile_left_ref": (480, 640, 3)}
    hand.width_m = 0.03
    with pytest.raises(SensorError, match="Open the gripper"):
        robot.connect()
    assert arm.closed and not robot.is_connected


def test_a_stop_stops_the_fingers_too(moving, hand, eventually):
    hand.takes_s = 30.0
    eventually(lambda: moving.send_action(action(width=0.0)) and bool(hand.commands))
    moving.hold()
    eventually(lambda: hand.stops == 1)
    time.sleep(0.05)
    assert len(hand.commands) == 1, "the closing that was wished is forgotten"
    assert moving.stored_facts()["load_kg"] == 0.0


def test_after_the_watchdog_a_wish_to_stay_stays(robot, arm, eventually):
    robot.config.stream = replace(robot.config.stream, stale_s=0.1)
    robot.connect()
    arm.follows = False
    robot.send_action(action(0.02, 0.05))
    eventually(lambda: robot.guard_counts["watchdog"] == 1)
    seen = robot.get_observation()
    assert robot.send_action(seen) == pytest.approx(seen, abs=1e-6), "nothing of the old target"


def test_holding_refuses_nothing_afterwards(robot):
    robot.hold()
    robot.connect()
    robot.send_action(action())
    robot.hold()
    assert robot.send_action(action(0.01))["x.pos"] == pytest.approx(0.46)
