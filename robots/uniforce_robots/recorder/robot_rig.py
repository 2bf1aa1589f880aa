"""The Franka with its fingers and cameras as a rig. Never run on hardware."""

import contextlib
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from lerobot.cameras import Camera

from uniforce_datasets.features import vector_column
from uniforce_datasets.rig_settings import plain_settings
from uniforce_robots.franka import UniforceFranka
from uniforce_robots.franka.poses import by_axis
from uniforce_robots.recorder.faults import named
from uniforce_robots.recorder.rig import FingerTouch, Observation, Rig, RigFacts
from uniforce_robots.sensors.finger import SampledCamera, TactileFinger, UniforceUskin
from uniforce_robots.sensors.plain_camera import Picture, PlainCamera
from uniforce_robots.sensors.reader import NS_PER_S
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, RobotError, SensorError, expected
from uniforce_vtla.keys import AXES, measured_key, tactile_name
from uniforce_vtla.sensors import get_sensor

COLUMNS = {
    "q": [f"q{n}_rad" for n in range(1, 8)],
    "dq": [f"dq{n}_rad_s" for n in range(1, 8)],
    # robot's estimate, base frame, not tared
    "wrench": ["fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm"],
    "hand": ["width_m", "is_grasped"],
    "link": ["success_rate", "arm_age_s", "hand_age_s"],
}
GARBAGE_OVER_s = 1.0
# bad pieces in that time: a few are a bad plug; a driver drops each, so nothing else shows them
GARBAGE_MOST = 5


class RobotRig(Rig):
    """A robot, read and driven through LeRobot's interface and its own readings.

    Not connected at first. Its tactile cameras are ``tactile_left`` and ``tactile_right``, all
    others look at the scene. ``window`` taxel scans are kept per tick (17 are one at 500 Hz), and
    raw tactile frames beside the dataset if ``keep_raw``.

    Raises ContractError: a finger without a tactile camera, or a camera of unknown age.
    """

    def __init__(self, robot: UniforceFranka, window: int = 17, keep_raw: bool = True) -> None:
        self.robot = robot
        self._window = window
        self._keep_raw = keep_raw
        self._fingers: dict[Finger, TactileFinger] = {f: _finger(robot.cameras, f) for f in FINGERS}
        tactile = [tactile_name(finger) for finger in FINGERS]
        self._scene: dict[str, SampledCamera | PlainCamera] = {}
        self._sampled: dict[str, SampledCamera] = {}
        self._watches: dict[str, GarbageWatch] = {}
        for name, camera in robot.cameras.items():
            if isinstance(camera, SampledCamera):
                self._sampled[name] = camera
                self._watches[name] = GarbageWatch(name)
            if name not in tactile:
                self._scene[name] = self._sampled.get(name) or PlainCamera(name, camera)
        self._references: dict[Finger, np.ndarray] = {}
        self._rest_N: np.ndarray = np.zeros(3)
        sensors = {}
        raw_frames = {}
        windows = {}
        for finger, device in self._fingers.items():
            sensors[finger] = device.config.sensor
            if get_sensor(device.config.sensor).signal == "taxel":
                windows[finger] = window
            elif keep_raw:
                raw_frames[finger] = device.config.raw_shape
        cameras = {}
        for name, config in robot.config.cameras.items():
            if name not in tactile:
                cameras[name] = (config.height, config.width, 3)
        self.facts = RigFacts(
            name=robot.name,
            fps=round(robot.config.fps),
            sensors=sensors,
            cameras=cameras,
            raw_frames=raw_frames,
            windows=windows,
            measured={measured_key(name): vector_column(names) for name, names in COLUMNS.items()},
        )

    def now_s(self) -> float:
        """Return the host's monotonic clock, which stamps cameras, taxels and arm alike."""
        return time.perf_counter()

    def connect(self) -> None:
        """Connect arm, hand and sensors; references are taken per episode, not now."""
        for device in self._fingers.values():
            device.config.reference_on_connect = False
        self.robot.connect()

    def close(self) -> None:
        """Disconnect; the arm stops where it is."""
        self.robot.disconnect()

    def axes(self) -> np.ndarray:
        """Return (5,) where the robot is."""
        return self.robot.measured()

    def begin_episode(self, seed: int) -> None:
        """Take references, gripper open and fingers still; the force of now counts as none."""
        self.robot.require_open_hand()
        for finger, device in self._fingers.items():
            with named("touch", tactile_name(finger)):
                self._references[finger] = device.take_reference()
        self.observe()  # every sensor must be well
        self._rest_N = np.array(self.robot.reading[0].wrench_N[:3])

    def observe(self) -> Observation:
        """Return the newest of everything, the arm last: it is the fastest."""
        cameras = {name: self._picture(name, camera) for name, camera in self._scene.items()}
        fingers = {finger: self._touch(finger, device) for finger, device in self._fingers.items()}
        axes = self.robot.measured()
        (arm, hand) = self.robot.reading
        now_s = time.monotonic()
        columns = {
            "q": arm.q_rad,
            "dq": arm.dq_rad_s,
            "wrench": arm.wrench_N,
            "hand": [hand.width_m, hand.is_grasped],
            "link": [arm.success_rate, now_s - arm.time_s, now_s - hand.time_s],
        }
        measured = {
            measured_key(name): np.asarray(column, np.float32) for name, column in columns.items()
        }
        return Observation(
            self.now_s(), axes, cameras, fingers, measured, arm.wrench_N[:3] - self._rest_N
        )

    def act(self, action: np.ndarray) -> np.ndarray:
        """Send five absolute targets through the guards."""
        sent = self.robot.send_action(by_axis(action))
        return np.array([sent[axis] for axis in AXES])

    def hold(self) -> None:
        """Rest here; an arm that has stopped already rests."""
        with contextlib.suppress(RobotError):
            self.robot.hold()

    def recover(self) -> None:
        """Clear a reflex on a person's word."""
        self.robot.recover()

    def stored_facts(self) -> dict[str, Any]:
        """Return the robot's own, if it says any, as end-effector frame and load."""
        facts = getattr(self.robot, "stored_facts", dict)
        return plain_settings("robot.stored", facts())

    def summary(self) -> dict[str, Any]:
        """Return how often each guard acted so far, and counts of the sensors."""
        sensors = {name: _summary(device) for name, device in self._sampled.items()}
        return {"guards": self.robot.guard_counts, "sensors": sensors}

    def _picture(self, name: str, camera: SampledCamera | PlainCamera) -> Picture:
        with named("camera", name):
            if isinstance(camera, PlainCamera):
                return camera.picture()
            self._watches[name].look(time.monotonic(), camera.counts.bad)
            sample = camera.latest()
            return Picture(sample.raw, sample.index, sample.stamp_ns / NS_PER_S)

    def _touch(self, finger: Finger, device: TactileFinger) -> FingerTouch:
        """Return the marker image of the very sample whose raw signal is beside it."""
        with named("touch", name := tactile_name(finger)):
            self._watches[name].look(time.monotonic(), device.counts.bad)
            sample = device.latest()
            image = device.marker_image(sample.raw)
            window = _window(device, self._window) if isinstance(device, UniforceUskin) else ()
        raw = sample.raw if window or self._keep_raw else None
        taken_s = sample.stamp_ns / NS_PER_S
        reference = self._references[finger]
        return FingerTouch(image, sample.index, taken_s, reference, raw, *window)


class GarbageWatch:
    """Watches a driver's count of pieces that it could not understand."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._seen: deque[tuple[float, int]] = deque()

    def look(self, now_s: float, bad: int) -> None:
        """Take the count so far; raise SensorError: over ``GARBAGE_MOST`` more within a second."""
        self._seen.append((now_s, bad))
        while now_s - self._seen[0][0] > GARBAGE_OVER_s:
            self._seen.popleft()
        came = bad - self._seen[0][1]
        if came > GARBAGE_MOST:
            wanted = f"≤ {GARBAGE_MOST} bad pieces in {GARBAGE_OVER_s:g} s"
            do = "Check cable, power and what else is on the bus."
            raise SensorError(expected(self._name, wanted, came, do))


def _finger(cameras: Mapping[str, Camera], finger: Finger) -> TactileFinger:
    name = tactile_name(finger)
    device = cameras.get(name)
    if not isinstance(device, TactileFinger) or device.config.finger != finger:
        came = "none"
        if device is not None:
            came = f"{type(device).__name__} for {getattr(device, 'config', None)}"
        do = f"List it in the robot's cameras, with finger={finger}."
        raise ContractError(expected(name, "a uniforce_tactile or uniforce_uskin camera", came, do))
    return device


def _window(device: UniforceUskin, size: int) -> tuple[np.ndarray, np.ndarray]:
    stamps_ns, scans = device.window(size)
    return scans, stamps_ns / NS_PER_S


def _summary(device: SampledCamera) -> dict[str, Any]:
    rate_hz = round(device.rate_hz, 2)
    settings = device.settings_read_back
    return {
        "rate_hz": rate_hz,
        **asdict(device.counts),
        "reconnects": device.reconnects,
        "settings": settings,
    }
