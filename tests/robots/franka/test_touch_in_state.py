"""The robot for any LeRobot policy: the right finger's newtons behind the axes, no marker
images."""

from unittest.mock import Mock

import numpy as np
import pytest
from calibration_samples import save_calibration
from robot_fakes import refused

from uniforce_datasets.synthetic import dots
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka import robot as module
from uniforce_robots.recorder.build import read_devices
from uniforce_robots.sensors import UniforceTactileCameraConfig, UniforceUskinConfig
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.keys import AXES, force_axes
from uniforce_vtla.tokenizer import Tokenizer


def finger():
    """As a tactile camera is to the robot."""
    reference, current = (np.repeat(dots(by)[..., None], 3, axis=2) for by in (0, 8))
    return Mock(
        is_connected=False,
        read_latest=lambda: current,
        reference_image=lambda: reference,
    )


def fingers():
    left = UniforceUskinConfig(source="ws://127.0.0.1:1", finger="left")
    right = UniforceTactileCameraConfig(sensor="tactip", finger="right", source="/dev/video0")
    return {"tactile_left": left, "tactile_right": right}


@pytest.fixture
def robot(make_robot, monkeypatch):
    robot = make_robot(cameras=fingers(), touch_in_state=True)
    robot.cameras = {}
    monkeypatch.setattr(module, "require_open", lambda *given: None)
    robot.connect()
    robot.cameras = {name: finger() for name in fingers()}
    yield robot
    robot.disconnect()


def test_the_state_ends_with_newtons_and_shows_no_markers(robot):
    names = [*AXES, *force_axes("right")]
    seen = robot.get_observation()
    assert list(robot.observation_features) == names == list(seen)
    right = robot.cameras["tactile_right"]
    wanted_N = ForceSensor("", "right").read_forces(
        right.reference_image()[..., 0], right.read_latest()[None, ..., 0]
    )
    np.testing.assert_allclose([seen[name] for name in names[5:]], wanted_N[0], atol=1e-5)


def test_a_finger_that_cannot_be_read_stops_the_robot(robot):
    robot.cameras["tactile_right"].reference_image()[:] = 0
    with pytest.raises(ContractError, match="reference"):
        robot.get_observation()
    with refused("sensor"):
        robot.send_action(dict.fromkeys(AXES, 0.1))


def test_a_calibration_of_another_kind_is_refused(tmp_path):
    folder = save_calibration(tmp_path, Tokenizer.from_pretrained(), new="uskin:2")
    settings = UniforceFrankaConfig(
        cameras=fingers(), touch_in_state=True, right_calibration=folder
    )
    with pytest.raises(CheckpointError, match="one of a tactip"):
        UniforceFranka(settings)


def test_settings_that_read_nothing_are_refused(tmp_path):
    left = {"tactile_left": fingers()["tactile_left"]}
    with pytest.raises(ContractError, match="finger: right"):
        UniforceFranka(UniforceFrankaConfig(cameras=left, touch_in_state=True))
    with pytest.raises(ContractError, match="recording"):
        read_devices(["--robot.touch_in_state=true"], True, "keyboard")
    with pytest.raises(ContractError, match="touch_in_state"):
        UniforceFrankaConfig(cameras=fingers(), right_calibration=str(tmp_path))
