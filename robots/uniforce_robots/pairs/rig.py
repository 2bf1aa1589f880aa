"""Rig of a pair recorder: frames of both fingers with the hand's motion; and the real one.

The real one is a Franka led by hand with two tactile fingers; it has never run on hardware. The
hand's velocity and acceleration come from a polynomial through its last measured poses. The robot
must be soft (``HAND_GUIDED`` gains). A Franka Hand measures its width, not its force: the grip is
the commanded force.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from uniforce_robots.franka import UniforceFranka
from uniforce_robots.sensors.finger import TactileFinger
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import ContractError, expected

CLOSING = 0  # index of the closing axis in the hand's velocities and accelerations
POSES = 7  # of the fit: a quarter of a second at 30 Hz
OPENED_m = 0.003  # fingers that open by so much have let go


@dataclass(frozen=True)
class RigFrame:
    """One moment."""

    grasp: int  # counts grasps; a new number means the fingers had opened between
    images: dict[Finger, np.ndarray]  # finger → (480, 640) uint8 marker image, as the sensor saw it
    velocity_m_s: np.ndarray  # (3,) of the hand in its own frame, x = the fingers' closing axis
    acceleration_m_s2: np.ndarray  # (3,) of the hand in its own frame
    grip_N: float  # the gripper's own estimate of its force


class PairRig(Protocol):
    """A hand with two tactile fingers."""

    sensors: dict[Finger, str]  # finger → registry name
    rate_hz: float  # frames per second
    mass_kg: float  # of the held object with what moves of its holder, as weighed

    def references(self) -> dict[Finger, np.ndarray]:
        """Return the session's free-air references (480, 640)."""

    def frames(self, indenter: str) -> Iterator[RigFrame]:
        """Yield frames for as long as one asks, of grasps of one indenter."""


class HandMotion:
    """Velocity and acceleration (3,) of the hand in its own frame: a parabola through poses."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=POSES)
        self._positions: deque[np.ndarray] = deque(maxlen=POSES)

    def __call__(self, time_s: float, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take a measured pose (5,) and return both; zeros before there are enough poses.

        Raises ContractError: time stood still or ran backwards.
        """
        if self._times and time_s <= self._times[-1]:
            do = "Give each pose once, with its time."
            raise ContractError(
                expected("pose", "a later one than the last", time_s - self._times[-1], do)
            )
        self._times.append(time_s)
        self._positions.append(np.array(axes[:3], dtype=np.float64))
        if len(self._times) < POSES:
            return np.zeros(3), np.zeros(3)
        now = np.array(self._times) - self._times[-1]
        # (3, 3) by power and axis
        curve = np.polynomial.polynomial.polyfit(now, np.array(self._positions), 2)
        # at yaw 0 the fingers close along the base's x
        to_hand = Rotation.from_euler("z", -axes[3]).as_matrix()
        return to_hand @ curve[1], 2 * to_hand @ curve[2]


class HandLedRig:
    """A ``PairRig`` on a robot that is connected and soft, and fingers that are connected.

    The gripper is commanded to hold with ``grip_N``. ``steer`` is called with each measured pose
    (5,): it lets a soft arm follow the hand that leads it.
    """

    def __init__(
        self,
        robot: UniforceFranka,
        fingers: Mapping[Finger, TactileFinger],
        sensors: dict[Finger, str],
        rate_hz: float,
        mass_kg: float,
        grip_N: float,
        steer: Callable[[np.ndarray], None] = lambda measured: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.sensors = sensors
        self.rate_hz = rate_hz
        self.mass_kg = mass_kg
        self._robot = robot
        self._fingers = fingers
        self._grip_N = grip_N
        self._steer = steer
        self._clock = clock
        self._grasp = 0
        # widest since they opened, or narrowest since they closed
        self._is_open = True
        self._turning_m = 0.0

    def references(self) -> dict[Finger, np.ndarray]:
        """Return the free-air references of the open fingers; ContractError: none was taken."""
        return {
            f: np.ascontiguousarray(c.reference_image()[..., 0]) for f, c in self._fingers.items()
        }

    def frames(self, indenter: str) -> Iterator[RigFrame]:
        """Yield a frame whenever both fingers have a new image.

        Raises SensorError: a finger is lost, frozen or stale; RobotError: the robot has a fault.
        """
        motion = HandMotion()
        while True:
            images = {
                f: np.ascontiguousarray(c.async_read()[..., 0]) for f, c in self._fingers.items()
            }
            axes = self._robot.measured()
            self._steer(axes)
            velocity, acceleration = motion(self._clock(), axes)
            yield RigFrame(
                self._count_grasps(float(axes[4])), images, velocity, acceleration, self._grip_N
            )

    def _count_grasps(self, width_m: float) -> int:
        """Return the number of this grasp: it ends, once, when the fingers open."""
        if self._is_open:
            self._turning_m = max(self._turning_m, width_m)
            if width_m < self._turning_m - OPENED_m:
                self._is_open = False
                self._turning_m = width_m
        else:
            self._turning_m = min(self._turning_m, width_m)
            if width_m > self._turning_m + OPENED_m:
                self._is_open = True
                self._turning_m = width_m
                self._grasp += 1
        return self._grasp
