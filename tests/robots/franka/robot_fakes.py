"""An arm and a hand that do what they are asked at once, and fail when they are asked to."""

import time

import numpy as np

from uniforce_robots.fr3 import HAND_TO_FLANGE
from uniforce_robots.franka.arm import ArmSetup, ArmState
from uniforce_robots.franka.guards import towards
from uniforce_robots.franka.poses import ToolPose
from uniforce_vtla.errors import RobotError

START = ToolPose(np.array([0.45, 0.0, 0.3]), 0.0)
SPEED_m_s = 1.5  # of the fake: at once for a test, possible for an arm


class FakeArm:
    def __init__(self) -> None:
        self.pose = START.ee_to_base()
        self._moved_s = time.monotonic()
        self.mode = "idle"
        self.targets: list[tuple[float, np.ndarray]] = []
        self.fault: RobotError | None = None
        self.stopped_at: list[float] = []
        self.closed = False
        self.follows, self._pulls = True, False
        self.blocks_s = 0.0  # how long its client takes for a reading
        self.success_rate = 1.0
        self.wrench_N = np.zeros(6)
        self.readings = 0
        self.setup = ArmSetup(HAND_TO_FLANGE, 0.0)

    def connect(self) -> None:
        pass

    def state(self) -> ArmState:
        if self.fault is not None:
            raise self.fault
        time.sleep(self.blocks_s)
        self.readings += 1
        now = time.monotonic()
        self._move(now)
        q_rad = np.full(7, 1e-9 * self.readings)  # encoders never read the same twice
        measured = q_rad, np.zeros(7), self.pose.copy(), self.wrench_N
        return ArmState(now, now, *measured, self.mode, self.success_rate)

    def set_target(self, ee_to_base: np.ndarray) -> None:
        if self.fault is not None:
            raise self.fault
        self.targets.append((time.monotonic(), ee_to_base.copy()))
        self._pulls = True

    def _move(self, now_s: float) -> None:
        reach_m, self._moved_s = SPEED_m_s * min(now_s - self._moved_s, 0.015), now_s
        if self.follows and self._pulls:
            pose = self.targets[-1][1].copy()
            pose[:3, 3] = towards(self.pose[:3, 3], pose[:3, 3], reach_m)
            self.pose = pose

    def stop(self, at_once: bool = False) -> None:
        self._pulls = False
        self.stopped_at.append(time.monotonic())

    def recover(self) -> None:
        self.fault, self.mode = None, "idle"

    def close(self) -> None:
        self.closed = True
