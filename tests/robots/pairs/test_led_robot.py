"""Pairs from a Franka that is led by hand: what its rig says is used, and it is let go of."""

import itertools
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from recording_fakes import FakeRig

from uniforce_cli.pairs import RecordPairsConfig, _robot, _robot_rig, main
from uniforce_robots.franka import UniforceFrankaConfig
from uniforce_robots.franka.arm import Gains
from uniforce_robots.recorder import build
from uniforce_robots.teleop import UniforceHandGuide, UniforceHandGuideConfig
from uniforce_vtla.errors import ContractError

RIG = """
robot:
  address: 127.0.0.7
  guards: {low: [0.3, -0.2, 0.1, -0.5, 0.0]}
  cameras:
    front: {type: uniforce_scene, source: "http://x"}
    tactile_left:
      {type: uniforce_uskin, finger: left, source: /dev/x, flip: true, reference_on_connect: false}
    tactile_right:
      {type: uniforce_tactile, finger: right, sensor: tactip, source: /dev/y, rotation_deg: 180}
"""


@pytest.fixture
def config(tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    return RecordPairsConfig(
        "franka", rig=str(tmp_path / "rig.yaml"), out=str(tmp_path / "pairs"), grip_N=7.0
    )


def test_mounts_and_box_come_from_the_rig(config):
    robot = _robot(config, ["--robot.guards.step_m=0.02"])
    assert (robot.address, robot.guards.low[0], robot.guards.step_m) == ("127.0.0.7", 0.3, 0.02)
    assert set(robot.cameras) == {"tactile_left", "tactile_right"}  # nothing else is opened
    assert robot.cameras["tactile_left"].flip
    assert robot.cameras["tactile_right"].rotation_deg == 180
    assert all(finger.reference_on_connect for finger in robot.fingers.values())
    assert [config.left_sensor, config.right_sensor] == ["uskin", "tactip"]
    assert robot.gripper.grip_force_N == 7.0


def test_a_grip_of_the_rig_is_not_dropped(config):
    assert _robot(config, ["--robot.gripper.grip_force_N=7"]).gripper.grip_force_N == 7.0
    with pytest.raises(ContractError, match=r"grip_N=7, got 3\.0"):
        _robot(config, ["--robot.gripper.grip_force_N=3"])


def test_softer_gains_of_the_rig_are_not_dropped(tmp_path):
    soft = Gains((50.0, 50.0, 50.0), clip_m=(0.01, 0.01, 0.01))
    robot = UniforceFrankaConfig(calibration_dir=tmp_path, gains=soft)
    guide = UniforceHandGuide(UniforceHandGuideConfig(calibration_dir=tmp_path))
    with pytest.raises(ContractError, match=r"uniforce_hand_guide.*50"):
        build.make_robot(robot, guide)
    assert build.make_robot(robot, SimpleNamespace()).config.gains == soft
    robot = UniforceFrankaConfig(calibration_dir=tmp_path)
    assert build.make_robot(robot, guide).config.gains == guide.wants_gains


@pytest.mark.parametrize(
    "words, reason",
    [
        ("robot=franka", "tactile fingers of the rig"),
        ("robot=franka left_sensor=gelsight", "left_sensor"),
        ("robot.address=127.0.0.7", "robot.address"),
        ("mass_kg=0.2", "mass_kg"),
    ],
)
def test_a_rig_without_fingers_and_settings_without_use_are_refused(
    words, reason, tmp_path, refuses
):
    refuses(main, [*words.split(), f"out={tmp_path / 'pairs'}"], reason)
    assert not (tmp_path / "pairs").exists()


def test_a_soft_robot_follows_and_gives_frames(config, terminal, tmp_path, monkeypatch):
    fake = FakeRig(tmp_path / "calibration", monkeypatch)
    make_robot = Mock(return_value=fake.robot)
    monkeypatch.setattr(build, "make_robot", make_robot)
    with _robot_rig(config, SimpleNamespace(), 30.0) as rig:
        assert rig.sensors == {"left": "gelsight", "right": "tactip"}
        assert {image.shape for image in rig.references().values()} == {(480, 640)}
        frames = list(itertools.islice(rig.frames("ball"), 5))
    assert {frame.grip_N for frame in frames} == {7.0} and frames[-1].images["right"].any()
    make_robot.assert_called_once()
    assert isinstance(make_robot.call_args.args[1], UniforceHandGuide)
    assert not fake.robot.is_connected
