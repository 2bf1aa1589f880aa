"""An arm that does what it is asked at once; errors by their fault."""

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
        yield caught
    assert caught.value.fault == fault


class FakeArm:
    setup = ArmSetup(HAND_TO_FLANGE, 0.0)
    mode = "idle"
    success_rate = 1.0
    blocks_s = 0.0  # how long its client takes for a reading
    follows = True
    closed = _pulls = False
    stops = _readings = 0

    def __init__(self):
        self.pose = START.ee_to_base()
        self.targets = []
        self._moved_s = time.monotonic()

    def connect(self):
        self.mode = "idle"

    recover = connect

    def state(self):
        time.sleep(self.blocks_s)
        self._readings += 1
        now = time.monotonic()
        self._move(now)
        q_rad = np.full(7, 1e-9 * self._readings)  # encoders never read the same twice
        measured = q_rad, np.zeros(7), self.pose.copy(), np.zeros(6)
        return ArmState(now, now, *measured, self.mode, self.success_rate)

    def set_target(self, ee_to_base):
        self.targets.append(ee_to_base.copy())
        self._pulls = True

    def _move(self, now_s):
        reach_m = SPEED_m_s * min(now_s - self._moved_s, 0.015)
        self._moved_s = now_s
        if self.follows and self._pulls:
            pose = self.targets[-1].copy()
            pose[:3, 3] = towards(self.pose[:3, 3], pose[:3, 3], reach_m)
            self.pose = pose

    def stop(self, at_once=False):
        self._pulls = False
        self.stops += 1

    def close(self):
        self.closed = True
