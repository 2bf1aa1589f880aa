"""An arm and a hand that do what they are asked at once, and fail when they are asked to."""

import time
from collections.abc import Callable

import numpy as np

from uniforce_robots.fr3 import HAND_TO_FLANGE
from uniforce_robots.franka.arm import ArmSetup, ArmState
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


class FakeHand:
    """Takes a while for each command; keeps what it was asked, and whether two ever overlapped.

    ``moves``: its fingers go at their speed and close on an object of ``object_m``; else they are there at the end.
    """

    def __init__(
        self,
        takes_s: float = 0.1,
        succeeds: bool = True,
        clock: Callable[[], float] = time.monotonic,
        moves: bool = False,
    ) -> None:
        self.takes_s, self.succeeds, self.clock, self.moves = takes_s, succeeds, clock, moves
        self.width_m, self.max_width_m, self.object_m = 0.08, 0.08, 0.0
        self.commands: list[HandCommand] = []
        self.overlaps = self.stops = 0
        self.fault: RobotError | None = None
        self.closed = False
        self.is_grasped = self.closed_by_hand = False
        self.silent_since_s: float | None = None  # readings repeat from then on
        self._ends_s: float | None = None
        self._outcome: bool | None = None
        self._looked_s = 0.0

    def connect(self) -> None:
        if self.fault is not None:
            raise self.fault

    def begin(self, command: HandCommand) -> None:
        self.overlaps += self._ends_s is not None
        self.commands.append(command)
        self.is_grasped &= not self.moves
        goal_m = self._goal_m(command)
        takes_s = abs(goal_m - self.width_m) / command.speed_m_s if self.moves else self.takes_s
        self._looked_s = self.clock()
        self._ends_s = self._looked_s + takes_s

    def _goal_m(self, command: HandCommand) -> float:
        if not self.moves:
            return command.width_m
        closes_on_m = self.object_m if self.width_m >= self.object_m else 0.0
        return max(0.0 if command.force_N else command.width_m, closes_on_m)

    def stop(self) -> None:
        self.advance()
        self.stops += 1
        if self._ends_s is not None:
            self._ends_s, self._outcome = None, False

    def advance(self) -> None:
        """Let the fingers go as far as the time since the last look allows."""
        now_s, command = self.clock(), self.commands[-1] if self.commands else None
        elapsed_s, self._looked_s = now_s - self._looked_s, now_s
        if command is None or self._ends_s is None:
            return
        if self.moves:
            step_m = command.speed_m_s * elapsed_s
            self.width_m += float(np.clip(self._goal_m(command) - self.width_m, -step_m, step_m))
        if now_s < self._ends_s:
            return
        self.width_m, self._ends_s, self._outcome = self._goal_m(command), None, self.succeeds
        if self.moves and command.force_N:
            self.is_grasped = self._outcome = 0 < self.object_m == self.width_m

    def poll(self) -> bool | None:
        self.advance()
        outcome, self._outcome = self._outcome, None
        return outcome

    def refuse_closed(self) -> None:
        if self.closed_by_hand:
            raise RobotError("closed", "hand_connection")

    def read(self) -> HandReading | None:
        if self.fault is not None:
            raise self.fault
        self.advance()
        now_s = self.clock() if self.silent_since_s is None else self.silent_since_s
        return HandReading(now_s, self.width_m, self.max_width_m, self.is_grasped)

    def close(self) -> None:
        self.closed = True
