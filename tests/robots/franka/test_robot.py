"""The LeRobot robot on a fake arm and hand: features, guarded actions, faults, no late motion."""

import importlib.util
import sys
import threading
import time
from dataclasses import dataclass, replace
from types import SimpleNamespace
from unittest import mock

import draccus
import numpy as np
import pytest
import torch
from lerobot.robots import RobotConfig, make_robot_from_config
from robot_fakes import START, refused

from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
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
def robot(make_robot):
    robot = make_robot()
    yield robot
    robot.disconnect()
    assert not [t for t in threading.enumerate() if t.name in ("arm-stream", "hand")], (
        "a thread is left"
    )


@pytest.fixture
def is_sent(arm, eventually):
    """Return a function that waits until the arm is sent to this x."""
    return lambda x_m: eventually(lambda: arm.targets and abs(arm.targets[-1][0, 3] - x_m) < 1e-9)


def action(dx=0.0, width=0.08):
    return dict(zip(AXES, [0.45 + dx, 0.0, 0.3, 0.0, width], strict=True))


@pytest.fixture
def moving(robot):
    """A robot that has been sent its first action."""
    robot.connect()
    robot.send_action(action())
    return robot


def test_features_are_the_five_axes(robot):
    assert list(robot.observation_features) == list(AXES) == list(robot.action_features)
    assert robot.name == "uniforce_franka" and robot.is_calibrated and not robot.is_connected
    assert robot.stored_facts()["load_kg"] == 0.0


def test_observation_and_action_go_through(robot, arm, is_sent):
    robot.connect()
    assert robot.get_observation() == pytest.approx(action())
    sent = robot.send_action(action(0.005, 0.03))
    assert sent["x.pos"] == pytest.approx(0.455)
    assert sent["width.pos"] == pytest.approx(0.07), "0.1 m/s over 0.1 s"
    is_sent(0.455)
    np.testing.assert_allclose(arm.targets[-1][:3, :3], START.ee_to_base()[:3, :3], atol=1e-12)


BAD = [  # whatever else a number may not be: the attack on the guards
    *({**action(), "yaw.pos": bad} for bad in (torch.zeros(5), np.zeros(2))),
    *(None, [0.45, 0, 0.3, 0, 0.08], "home", 3),
]


@pytest.mark.parametrize("bad", BAD, ids=str)
def test_whatever_is_no_action_stops_the_robot_until_it_recovers(moving, arm, eventually, bad):
    with refused("action") as caught:
        moving.send_action(bad)
    eventually(lambda: arm.stops)
    count = len(arm.targets)
    with pytest.raises(RobotError) as latched:
        moving.send_action(action())
    assert latched.value is caught.value
    assert len(arm.targets) == count and moving.is_connected, "its data can still be kept"
    moving.recover()
    moving.send_action(action())


def test_a_dropped_robot_lets_go_and_waits_for_no_thread(moving, arm, eventually):
    with mock.patch.object(threading.Thread, "join") as join:
        # by the collector, perhaps inside Thread.start: what joins there waits for itself
        moving.__del__()
        eventually(lambda: arm.stops)
    assert not join.called and not moving.is_connected


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


def test_ctrl_c_in_an_action_lets_the_arm_rest(robot, arm, is_sent):
    robot.connect()
    arm.follows = False
    robot.send_action(action(0.01))
    is_sent(0.46)
    robot.guards._finite = mock.Mock(side_effect=KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        robot.send_action(action())
    is_sent(0.45)


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
    assert len(arm.targets) == count and arm.closed and arm.stops


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
    sent = mock.Mock()
    wrapper = SimpleNamespace(get_observation=action, send_action=sent)
    hardware = SimpleNamespace(robot_wrapper=wrapper, initial_position=action(0.1))
    strategy = strategies.RolloutStrategy
    (name,) = (name for name in RETURN_MOTIONS if hasattr(strategy, name))

    def return_motion():
        getattr(strategy, name)(hardware, duration_s=0.04)

    return_motion()
    assert sent.called, "LeRobot's own would have moved; else forbid_return_motion can go"
    sent.reset_mock()
    assert forbid_return_motion() and forbid_return_motion()
    return_motion()
    assert not sent.called
    allow_return_motion()
    return_motion()
    assert sent.called, "other robots may return"


def test_a_rollout_that_calls_its_return_motion_otherwise_is_refused(robot, monkeypatch):
    monkeypatch.setitem(sys.modules, STRATEGIES, SimpleNamespace(RolloutStrategy=object))
    with pytest.raises(ContractError, match=r"return_to_initial_position.*neither"):
        robot.connect()
    assert not robot.is_connected


@pytest.mark.parametrize("name", RETURN_MOTIONS)
def test_no_arm_is_led_back_while_a_robot_is_connected(name, robot, make_robot, monkeypatch):
    strategy = type("RolloutStrategy", (), {name: staticmethod(lambda: "moves")})
    monkeypatch.setitem(sys.modules, STRATEGIES, SimpleNamespace(RolloutStrategy=strategy))
    with make_robot() as other:
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
    words = f"type=uniforce_franka calibration_dir={tmp_path} guards.step_m=0.03"
    words += " gains.clip_m=[0.01,0.01,0.02] gains.stiffness_N_m=[200,200,200]"
    config = draccus.parse(Program, args=[f"--robot.{word}" for word in words.split()]).robot
    assert isinstance(config, UniforceFrankaConfig)
    assert config.guards.step_m == 0.03
    assert config.gains == Gains((200, 200, 200), clip_m=(0.01, 0.01, 0.02))
    assert isinstance(make_robot_from_config(config), UniforceFranka)


@pytest.fixture
def camera(robot):
    """One of LeRobot's own."""
    camera = mock.Mock(height=4, width=6, latest_timestamp=0.0, is_connected=False)
    camera.read_latest.return_value = np.zeros((4, 6, 3), np.uint8)
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
    camera.read_latest.side_effect = [broken]
    with pytest.raises(kind):
        robot.get_observation()
    eventually(lambda: arm.stops)
    assert robot.guard_counts["sensor"] == 1
    with refused("sensor"):
        robot.send_action(action())
    robot.recover()
    camera.read_latest.side_effect = None
    robot.send_action(robot.get_observation())


def test_a_camera_that_repeats_itself_stops_the_arm(robot, camera, arm, eventually):
    robot.connect()
    robot.send_action(action())
    with pytest.raises(FrozenSensorError, match="front"):
        for _ in range(FROZEN_AFTER + 2):
            camera.latest_timestamp += 1 / 30
            robot.get_observation()
    eventually(lambda: arm.stops)


def test_a_cameras_pictures_are_stamped_and_counted_and_one_without_stamps_is_refused(camera):
    seen = []
    plain = PlainCamera("front", camera)
    for camera.latest_timestamp in (1.0, 1.0, 2.0):
        picture = plain.picture()
        seen.append((picture.index, picture.time_s))
    assert seen == [(0, 1.0), (0, 1.0), (1, 2.0)]
    with pytest.raises(ContractError, match="latest_timestamp"):
        PlainCamera("front", object())


def test_a_camera_that_cannot_be_connected_is_named(robot, camera, arm):
    camera.connect.side_effect = KeyError("device")
    with pytest.raises(SensorError, match="front: expected a camera that connects"):
        robot.connect()
    assert arm.closed and not robot.is_connected


def test_references_need_an_open_hand(make_robot, arm, hand):
    finger = UniforceTactileCameraConfig(
        source="http://127.0.0.1:9", finger="left", sensor="gelsight"
    )
    robot = make_robot(cameras={"tactile_left": finger})
    images = dict.fromkeys(("tactile_left", "tactile_left_ref"), (480, 640, 3))
    assert robot.observation_features == dict.fromkeys(AXES, float) | images
    hand.width_m = 0.03
    with pytest.raises(SensorError, match="Open the gripper"):
        robot.connect()
    assert arm.closed and not robot.is_connected


def test_after_the_watchdog_a_wish_to_stay_stays(robot, arm, eventually):
    robot.config.stream = replace(robot.config.stream, stale_s=0.1)
    robot.connect()
    arm.follows = False
    robot.send_action(action(0.02, 0.05))
    eventually(lambda: robot.guard_counts["watchdog"] == 1)
    seen = robot.get_observation()
    assert robot.send_action(seen) == pytest.approx(seen, abs=1e-6), "nothing of the old target"
