"""Contract of every registered teleoperator."""

import threading
import time

import draccus
import numpy as np
import pytest
from lerobot.scripts.lerobot_teleoperate import TeleoperateConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from robot_fakes import refused
from teleop_fakes import CONFIGS

import lerobot_policy_pi05_uniforce  # noqa: F401  LeRobot imports it alone: registers them all
from uniforce_robots.franka.poses import by_axis
from uniforce_vtla.errors import TeleoperatorError
from uniforce_vtla.keys import AXES

NAMES = sorted(
    name for name in TeleoperatorConfig.get_known_choices() if name.startswith("uniforce_")
)
LARGEST_STEP = np.array([0.03, 0.03, 0.03, 0.2, 0.03])  # of one call: limits × the longest gap


def test_every_registered_one_is_tested_here():
    assert sorted(CONFIGS) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_lerobots_own_commands_can_name_it(name):
    """Their parser reads class sources for help texts, and breaks over some."""
    flags = ["--robot.type=uniforce_franka", f"--teleop.type={name}"]
    assert draccus.parse(TeleoperateConfig, args=flags).teleop.type == name


@pytest.mark.parametrize("name", NAMES)
def test_life_of_a_teleoperator(name, connected, measured):
    threads = set(threading.enumerate())
    device = connected(name)
    assert isinstance(device, Teleoperator) and device.name == name and device.is_connected
    assert device.action_features == dict.fromkeys(AXES, float)
    assert device.is_calibrated is True
    with refused("not_started", TeleoperatorError):
        device.get_action()
    with pytest.raises(TeleoperatorError):
        device.connect()

    device.start_from(measured)
    device.send_feedback(by_axis(measured))
    before = measured
    for _ in range(5):
        action = device.get_action()
        assert tuple(action) == AXES and all(type(value) is float for value in action.values())
        now = np.array(list(action.values()))
        assert np.all(np.abs(now - before) <= LARGEST_STEP), name
        before = now

    device.disconnect()
    device.disconnect()
    assert not device.is_connected
    with refused("not_connected", TeleoperatorError):
        device.get_action()
    left = {thread.name for thread in set(threading.enumerate()) - threads}
    assert not [one for one in left if "reader" in one or one == name]
    device.connect()
    device.start_from(measured)
    device.send_feedback(by_axis(measured))
    assert device.get_action()


@pytest.mark.parametrize("name", NAMES)
def test_a_start_that_is_no_pose_is_refused(name, connected):
    device = connected(name)
    for wrong in (np.full(5, np.nan), np.zeros(4), {"x.pos": 0.0}):
        with pytest.raises(TeleoperatorError):
            device.start_from(wrong)


FAULTS = {
    "gello": {
        **dict.fromkeys(("crc", "missing", "garbage"), ("garbage", "stale")),
        **dict.fromkeys(("mute", "unplug"), ("connection", "stale")),
        "jump": ("garbage",),
    },
    "spacemouse": {"unplug": ("connection",), "garbage": ("garbage",), "short": ("garbage",)},
}


@pytest.mark.parametrize(
    "name, fault", [(name, fault) for name in FAULTS for fault in FAULTS[name]]
)
def test_faults_stay_until_the_next_start(
    name, fault, connected, measured, fault_of, starts, request
):
    device = connected(f"uniforce_{name}")
    stand_in = request.getfixturevalue(name)
    device.start_from(measured)
    stand_in.inject(fault)
    assert fault_of(device.get_action) in FAULTS[name][fault]
    stand_in.inject("none")
    time.sleep(0.1)
    # plugged in again, but no start has allowed the arm to go on
    with pytest.raises(TeleoperatorError):
        device.get_action()
    starts(device)
    assert device.get_action()


@pytest.mark.parametrize("name", NAMES)
def test_a_loss_that_no_tick_saw_is_one_too(name, connected, measured, starts):
    device = connected(name)
    device.start_from(measured)
    device.device.reconnects = 1
    for _ in range(2):
        with pytest.raises(TeleoperatorError, match="lost and came back"):
            device.get_action()
    starts(device)
