"""An arm and a hand that do what they are asked at once, and fail when they are asked to."""

import time
from collections.abc import Callable

import numpy as np

from uniforce_robots.franka.arm import ArmState
from uniforce_robots.franka.clients import HandCommand, HandReading
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
        self.refusals = 0  # how often it has said so
        self.stopped_at: list[float] = []
        self.connected = self.closed = False
        self.follows, self._pulls = True, False
        self.silent_since_s: float | None = None  # its own clock stands still from then on
        self.blocks_s = 0.0  # how long its client takes for a reading
        self.success_rate = 1.0
        self.wrench_N = np.zeros(6)
        self.readings = 0

    def connect(self) -> None:
        self.connected = True

    def state(self) -> ArmState:
        if self.fault is not None:
            self.refusals += 1
            raise self.fault
        time.sleep(self.blocks_s)
        self.readings += 1
        now = time.monotonic()
        if self.silent_since_s is None:  # what it repeats is the same pose, too
            self._move(now)
        robot_s = now if self.silent_since_s is None else self.silent_since_s
        q_rad = np.full(7, 1e-9 * self.readings)  # encoders never read the same twice
        measured = q_rad, np.zeros(7), self.pose.copy(), self.wrench_N
        return ArmState(now, robot_s, *measured, self.mode, self.success_rate)

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
        self.stopped_at_once = at_once

    def recover(self) -> None:
        self.fault, self.mode = None, "idle"

    def close(self) -> None:
        self.closed = True


class FakeHand:
    """Takes a while for each command; keeps what it was asked, and whether it was ever interrupted."""

    reads_while_busy = True

    def __init__(
        self, takes_s: float = 0.1, succeeds: bool = True, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.takes_s, self.succeeds, self.clock = takes_s, succeeds, clock
        self.width_m = 0.08
        self.commands: list[HandCommand] = []
        self.overlaps = 0
        self.fault: RobotError | None = None
        self.closed = False
        self.is_grasped = self.closed_by_hand = False
        self.silent_since_s: float | None = None  # readings repeat from then on
        self._ends_s: float | None = None

    def connect(self) -> None:
        if self.fault is not None:
            raise self.fault

    def begin(self, command: HandCommand) -> None:
        self.overlaps += self._ends_s is not None
        self.commands.append(command)
        self._ends_s = self.clock() + self.takes_s

    def poll(self) -> bool | None:
        if self._ends_s is None or self.clock() < self._ends_s:
            return None
        self._ends_s = None
        self.width_m = self.commands[-1].width_m
        return self.succeeds

    def refuse_closed(self) -> None:
        if self.closed_by_hand:
            raise RobotError("closed", "hand_connection")

    def read(self) -> HandReading | None:
        if self.fault is not None:
            raise self.fault
        now_s = self.clock() if self.silent_since_s is None else self.silent_since_s
        return HandReading(now_s, self.width_m, 0.08, self.is_grasped)

    def close(self) -> None:
        self.closed = True
