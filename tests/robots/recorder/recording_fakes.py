"""A rig without hardware: fake arm and hand, captures that break on command, a scripted person."""

import time
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from hand_fakes import FakeHand
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from robot_fakes import FakeArm
from scripted import ScriptedCapture

from uniforce_robots import sensors
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka import robot as robot_module
from uniforce_robots.franka.limits import StreamSettings
from uniforce_robots.recorder.operators import Event, Operator
from uniforce_robots.recorder.robot_rig import RobotRig
from uniforce_robots.standins.scene import Scene, frame_cycle
from uniforce_vtla.keys import AXES

FPS = 30
SMALL = (96, 128)  # rows, columns of the scene cameras: tests encode on a busy machine


@cache
def gel_frames(sensor):
    """A still gel with a little camera noise, BGR; no two frames alike."""
    frame = frame_cycle(sensor, Scene(press_s=0.0, rest_s=0.1), 20)[0]
    rng = np.random.default_rng(0)
    noisy = [
        np.clip(frame + rng.normal(0, 1.5, frame.shape), 0, 255).astype(np.uint8) for _ in range(3)
    ]
    return tuple(cv2.cvtColor(one, cv2.COLOR_RGB2BGR) for one in noisy)


@cache
def room_frames():
    ramp = np.linspace(0, 200, SMALL[1], dtype=np.uint8)
    return tuple(
        np.ascontiguousarray(np.broadcast_to(np.roll(ramp, n)[None, :, None], (*SMALL, 3)))
        for n in range(0, 120, 7)
    )


class FakeCapture(ScriptedCapture):
    """Deliver frames at a rate; ``fault``: "", "stop" (failed reads), "stall" or "freeze"."""

    def __init__(self, frames):
        super().__init__()
        self.frames = frames
        self.fault = ""
        self._due_s = time.monotonic()

    def isOpened(self):  # noqa: N802
        return self.fault != "stop"

    def read(self):
        time.sleep(max(self._due_s - time.monotonic(), 0))
        self._due_s = max(self._due_s + 1 / FPS, time.monotonic())
        if self.fault == "stall":
            time.sleep(0.05)
        if self.fault in ("stop", "stall"):
            return False, None
        self.count += self.fault != "freeze"
        return True, self.frames[self.count % len(self.frames)]


class FakeRig:
    def __init__(self, folder, monkeypatch):
        self.arm = FakeArm()
        self.hand = FakeHand(takes_s=0.02)
        monkeypatch.setattr(robot_module, "make_backend", lambda config: (self.arm, self.hand))
        rows, columns = SMALL
        front = sensors.UniforceSceneCameraConfig(source="front", width=columns, height=rows)
        configs = {"front": front}
        self.captures = {"front": FakeCapture(room_frames())}
        for finger, sensor in (("left", "gelsight"), ("right", "tactip")):
            name = f"tactile_{finger}"
            size = {"capture_width": 640, "capture_height": 480}
            configs[name] = sensors.UniforceTactileCameraConfig(
                source=name, finger=finger, sensor=sensor, reference_samples=3, **size
            )
            self.captures[name] = FakeCapture(gel_frames(sensor))
        patient = StreamSettings(state_age_s=1.0)  # a busy machine
        config = UniforceFrankaConfig(
            id="test", calibration_dir=folder, cameras=configs, stream=patient
        )
        self.robot = UniforceFranka(config)
        for camera in self.robot.cameras.values():
            camera._source._factory = lambda source: self.captures[source]
        self.rig = RobotRig(self.robot)


@TeleoperatorConfig.register_subclass("recording_test")
@dataclass
class SwayConfig(TeleoperatorConfig):
    width_m: float = 0.08


class Sway(Teleoperator):
    """Moves x to and fro around where it started; plain LeRobot but for ``start_from``."""

    config_class = SwayConfig
    name = "recording_test"

    def __init__(self, config):
        super().__init__(config)
        self.width_m = config.width_m
        self.starts = []  # LeRobot's own commands know no start
        self.error = None
        self.calls = 0

    action_features = dict.fromkeys(AXES, float)
    feedback_features: dict[str, type] = {}  # noqa: RUF012
    is_calibrated = True
    is_connected = False

    def connect(self, calibrate=True):
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def calibrate(self, *_):
        pass

    configure = send_feedback = calibrate

    def start_from(self, axes):
        self.starts.append(axes)
        self.calls = 0

    def get_action(self):
        if self.error is not None:
            raise self.error
        self.calls += 1
        start = self.starts[-1] if self.starts else dict.fromkeys(AXES, 0.0)
        x_m = start["x.pos"] + 0.01 * np.sin(self.calls / 5)
        return start | {"x.pos": x_m, "width.pos": self.width_m}


class Script(Operator):
    """Say what a function says, given the phase and how often it was asked in it."""

    def __init__(self, say):
        self._say = say
        self._phase = None
        self._asked = 0

    def poll(self, phase):
        self._asked = self._asked + 1 if phase == self._phase else 0
        self._phase = phase
        return [e if isinstance(e, Event) else Event(e) for e in self._say(phase, self._asked)]
