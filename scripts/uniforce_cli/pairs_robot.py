"""The robot's side of ``uniforce pairs``: a soft Franka led by hand, two fingers. Never run on hardware."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from uniforce_cli.pairs import RecordPairsConfig
from uniforce_cli.touch import TouchConfig, opened
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.hand import HandSettings
from uniforce_robots.pairs.rig import RobotRig
from uniforce_robots.teleop import UniforceHandGuide, UniforceHandGuideConfig
from uniforce_vtla.contracts import Finger
from uniforce_vtla.keys import AXES


@contextlib.contextmanager
def opened_rig(config: RecordPairsConfig, rate_hz: float) -> Iterator[RobotRig]:
    """Connect fingers, keyboard and robot, in this order, and let go of them in the other.

    The fingers' references are taken while connecting: keep them in free air.

    Raises:
        SensorError, RobotError, TeleoperatorError: whatever is not there.
    """
    guide = UniforceHandGuide(UniforceHandGuideConfig())
    gains, hand = UniforceHandGuide.wants_gains, HandSettings(grip_force_N=config.grip_N)
    assert gains is not None
    robot = UniforceFranka(UniforceFrankaConfig(address=config.address, gains=gains, gripper=hand))

    def steer(measured: np.ndarray) -> None:
        """Let the soft arm follow the hand that leads it, frame by frame."""
        guide.send_feedback(dict(zip(AXES, measured.tolist(), strict=True)))
        robot.send_action(guide.get_action())

    with contextlib.ExitStack() as stack:
        left = stack.enter_context(opened(TouchConfig(config.left_sensor, config.left_source, "left")))
        right = stack.enter_context(opened(TouchConfig(config.right_sensor, config.right_source, "right")))
        guide.connect()
        stack.callback(guide.disconnect)
        robot.connect()
        stack.callback(robot.disconnect)
        fingers: dict[Finger, object] = {"left": left, "right": right}
        sensors: dict[Finger, str] = {"left": config.left_sensor, "right": config.right_sensor}
        guide.start_from(robot.measured())
        yield RobotRig(robot, fingers, sensors, rate_hz, config.mass_kg, config.grip_N, steer=steer)  # type: ignore[arg-type]
