"""The robot's side of ``uniforce pairs``: a soft Franka led by hand, two fingers. Never run on hardware."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from uniforce_vtla.contracts import Finger
from uniforce_vtla.keys import AXES

if TYPE_CHECKING:
    from uniforce_robots.franka import UniforceFranka
    from uniforce_robots.pairs.rig import RobotRig
    from uniforce_robots.teleop import UniforceHandGuide


@dataclass(frozen=True)
class RobotSession:
    """What a rig is made of; see ``RecordPairsConfig``."""

    address: str
    left_sensor: str
    left_source: str
    right_sensor: str
    right_source: str
    mass_kg: float
    grip_N: float
    rate_hz: float


@contextlib.contextmanager
def opened_rig(session: RobotSession) -> Iterator[RobotRig]:
    """Connect fingers, keyboard and robot, in this order, and let go of them in the other.

    The fingers' references are taken while connecting: keep them in free air.

    Raises:
        SensorError, RobotError, TeleoperatorError: whatever is not there.
    """
    from uniforce_cli.touch import TouchConfig, opened
    from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
    from uniforce_robots.franka.hand import HandSettings
    from uniforce_robots.pairs.rig import RobotRig
    from uniforce_robots.teleop import UniforceHandGuide, UniforceHandGuideConfig

    guide = UniforceHandGuide(UniforceHandGuideConfig())
    gains = UniforceHandGuide.wants_gains
    assert gains is not None
    robot = UniforceFranka(
        UniforceFrankaConfig(
            address=session.address, gains=gains, gripper=HandSettings(grip_force_N=session.grip_N)
        )
    )
    with contextlib.ExitStack() as stack:
        left = stack.enter_context(opened(TouchConfig(session.left_sensor, session.left_source, "left")))
        right = stack.enter_context(opened(TouchConfig(session.right_sensor, session.right_source, "right")))
        guide.connect()
        stack.callback(guide.disconnect)
        robot.connect()
        stack.callback(robot.disconnect)
        sensors: dict[Finger, str] = {"left": session.left_sensor, "right": session.right_sensor}
        guide.start_from(robot.measured())
        yield RobotRig(
            robot, {"left": left, "right": right}, sensors, session.rate_hz, session.mass_kg, session.grip_N,
            steer=_leading(guide, robot),
        )  # type: ignore[arg-type]  # fmt: skip


def _leading(guide: UniforceHandGuide, robot: UniforceFranka) -> Callable[[np.ndarray], None]:
    """Return what lets the soft arm follow the hand that leads it, frame by frame."""

    def steer(measured: np.ndarray) -> None:
        guide.send_feedback(dict(zip(AXES, measured.tolist(), strict=True)))
        robot.send_action(guide.get_action())

    return steer
