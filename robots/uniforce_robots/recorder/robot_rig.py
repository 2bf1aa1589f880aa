"""The Franka with its fingers and cameras as a rig. Never run on hardware."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np

from uniforce_datasets.features import vector_column
from uniforce_robots.franka import UniforceFranka
from uniforce_robots.franka.arm import ArmState
from uniforce_robots.franka.hand import HandReading
from uniforce_robots.recorder.rig import Observation, Rig, RigFacts
from uniforce_robots.recorder.sensing import Sensing
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import RobotError
from uniforce_vtla.keys import AXES, measured_key, tactile_name
from uniforce_vtla.sensors import get_sensor

JOINTS = range(1, 8)
COLUMNS = {
    "q": [f"q{n}_rad" for n in JOINTS],
    "dq": [f"dq{n}_rad_s" for n in JOINTS],
    "wrench": [
        "fx_N",
        "fy_N",
        "fz_N",
        "tx_Nm",
        "ty_Nm",
        "tz_Nm",
    ],  # the robot's estimate, base frame, not tared
    "hand": ["width_m", "is_grasped"],
    "link": ["success_rate", "arm_age_s", "hand_age_s"],
}


class RobotRig(Rig):
    """A connected robot, read and driven through LeRobot's interface and its own readings.

    Args:
        robot: not connected; its tactile cameras are ``tactile_left`` and ``tactile_right``.
        window: taxel scans kept per tick; 17 are one tick at 500 Hz.
        keep_raw: whether raw tactile frames are kept beside the dataset.

    Raises:
        ContractError: a finger without a sensor.
    """

    def __init__(self, robot: UniforceFranka, window: int = 17, keep_raw: bool = True) -> None:
        self.robot = robot
        self._sensing = Sensing(robot.cameras, window, keep_raw)
        self._rest_N: np.ndarray = np.zeros(3)
        devices = {finger: device.config for finger, device in self._sensing.fingers.items()}
        worn = {tactile_name(finger) for finger in FINGERS}
        taxels = {f for f, config in devices.items() if get_sensor(config.sensor).signal == "taxel"}
        self.facts = RigFacts(
            name=robot.name,
            fps=round(robot.config.fps),
            sensors={finger: config.sensor for finger, config in devices.items()},
            cameras={n: (c.height, c.width, 3) for n, c in robot.config.cameras.items() if n not in worn},
            raw_frames={f: c.raw_shape for f, c in devices.items() if keep_raw and f not in taxels},
            windows={finger: window for finger in FINGERS if finger in taxels},
            measured={measured_key(name): vector_column(names) for name, names in COLUMNS.items()},
        )

    def now_s(self) -> float:
        """Return the host's monotonic clock, which stamps cameras, taxels and arm alike."""
        return time.perf_counter()

    def connect(self) -> None:
        """Connect arm, hand and sensors; references are taken per episode, not now."""
        for device in self._sensing.fingers.values():
            device.config.reference_on_connect = False
        self.robot.connect()

    def close(self) -> None:
        """Disconnect; the arm stops where it is."""
        self.robot.disconnect()

    def axes(self) -> np.ndarray:
        """(5,) where the robot is."""
        return self.robot.measured()

    def begin_episode(self, seed: int) -> None:
        """Take references, gripper open and fingers still; the force of now counts as none."""
        self.robot.require_open_hand()
        self._sensing.take_references()
        self._rest_N = np.array(self.robot.reading[0].wrench_N[:3])

    def observe(self) -> Observation:
        """Return the newest of everything, the arm last: it is the fastest."""
        cameras, fingers = self._sensing.pictures(), self._sensing.touches()
        axes = self.robot.measured()
        arm, hand = self.robot.reading
        return Observation(
            time_s=self.now_s(),
            axes=axes,
            cameras=cameras,
            fingers=fingers,
            measured=_columns(arm, hand),
            force_N=arm.wrench_N[:3] - self._rest_N,
        )

    def act(self, action: np.ndarray) -> np.ndarray:
        """Send five absolute targets through the guards."""
        sent = self.robot.send_action(dict(zip(AXES, action.tolist(), strict=True)))
        return np.array([sent[axis] for axis in AXES])

    def hold(self) -> None:
        """Rest here; an arm that has stopped already rests."""
        with contextlib.suppress(RobotError):
            self.robot.hold()

    def recover(self) -> None:
        """Clear a reflex on a person's word."""
        self.robot.recover()

    def summary(self) -> dict[str, Any]:
        """Guards that acted so far, and how the sensors did."""
        return {"guards": self.robot.guard_counts, "sensors": self._sensing.summary()}


def _columns(arm: ArmState, hand: HandReading) -> dict[str, np.ndarray]:
    now_s = time.monotonic()
    values = {
        "q": arm.q_rad,
        "dq": arm.dq_rad_s,
        "wrench": arm.wrench_N,
        "hand": [hand.width_m, hand.is_grasped],
        "link": [arm.success_rate, now_s - arm.time_s, now_s - hand.time_s],
    }
    return {measured_key(name): np.asarray(value, dtype=np.float32) for name, value in values.items()}
