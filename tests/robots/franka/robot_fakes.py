"""An arm that does what it is asked at once, and fails when it is asked to; faults by name."""

import time
from contextlib import contextmanager

import numpy as np
import pytest

from uniforce_robots.fr3 import HAND_TO_FLANGE
from uniforce_robots.franka.arm import ArmSetup, ArmState
from uniforce_robots.franka.guards import towards
from uniforce_robots.franka.poses import ToolPose
from uniforce_vtla.errors import RobotError

START = ToolPose(np.array([0.45, 0.0, 0.3]), 0.0)
SPEED_m_s = 1.5  # of the fake: at once for a test, possible for an arm


@contextmanager
def refused(fault, kind=RobotError, match=None):
    """Expect an error with this ``fault``."""
    with pytest.raises(kind, match=match) as caught:
        yield
    assert caught.value.fault == fault


class FakeArm:
    def __init__(self):
        self.pose = START.ee_to_base()
        self._moved_s = time.monotonic()
        self.mode = "idle"
        self.targets = []
        self.fault = None
        self.stopped_at = []
        self.closed = False
        self.follows = True
        self._pulls = False
        self.blocks_s = 0.0  # how long its client takes for a reading
        self.success_rate = 1.0
        self.wrench_N = np.zeros(6)
        self.readings = 0
        self.setup = ArmSetup(HAND_TO_FLANGE, 0.0)

    def connect(self):
        pass

    def state(self):
        if self.fault is not None:
            raise self.fault
        time.sleep(self.blocks_s)
        self.readings += 1
        now = time.monotonic()
        self._move(now)
        q_rad = np.full(7, 1e-9 * self.readings)  # encoders never read the same twice
        measured = q_rad, np.zeros(7), self.pose.copy(), self.wrench_N
        return ArmState(now, now, *measured, self.mode, self.success_rate)

    def set_target(self, ee_to_base):
        if self.fault is not None:
            raise self.fault
        self.targets.append((time.monotonic(), ee_to_base.copy()))
        self._pulls = True

    def _move(self, now_s):
        reach_m = SPEED_m_s * min(now_s - self._moved_s, 0.015)
        self._moved_s = now_s
        if self.follows and self._pulls:
            pose = self.targets[-1][1].copy()
            pose[:3, 3] = towards(self.pose[:3, 3], pose[:3, 3], reach_m)
            self.pose = pose

    def stop(self, at_once=False):
        self._pulls = False
        self.stopped_at.append(time.monotonic())

    def recover(self):
        self.fault = None
        self.mode = "idle"

    def close(self):
        self.closed = True
