"""The LeRobot robot: five axes and cameras in, five guarded axes out."""

import inspect
import logging
import math
import reprlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any
from weakref import WeakSet

import numpy as np
from lerobot.cameras import Camera, make_cameras_from_configs
from lerobot.robots import Robot

from uniforce_robots.franka.arm import ArmState
from uniforce_robots.franka.clients import make_backend
from uniforce_robots.franka.config import UniforceFrankaConfig
from uniforce_robots.franka.guards import GuardChain
from uniforce_robots.franka.poses import ToolPose, by_axis
from uniforce_robots.franka.stream import ArmStream
from uniforce_robots.sensors.finger import SampledCamera
from uniforce_robots.sensors.plain_camera import PlainCamera
from uniforce_vtla.errors import ContractError, RobotError, SensorError, UniForceError, expected
from uniforce_vtla.hand import Hand, HandReading, require_open
from uniforce_vtla.keys import AXES, force_axes

log = logging.getLogger(__name__)
STRATEGIES = "lerobot.rollout.strategies.core"
CONNECTED: WeakSet["UniforceFranka"] = WeakSet()  # while there is one, nothing leads an arm back
# LeRobot 0.6's name, and its main's
RETURN_MOTIONS = ("_return_to_initial_position", "return_to_initial_position")
# LeRobot's rollout strategy and its own return motion, while that is replaced
_replaced: list[tuple[type, str, Any]] = []


def forbid_return_motion() -> bool:
    """Replace the return motion of LeRobot's rollout by a line in the log.

    It would lead the arm back to its start, through whatever is there, even after a stop. The robot
    can't tell those actions from a policy's. Return whether a rollout is loaded.

    Raises ContractError: this LeRobot calls that motion by another name.
    """
    module = sys.modules.get(STRATEGIES)
    if module is None:
        return False
    strategy = module.RolloutStrategy
    names = [name for name in RETURN_MOTIONS if hasattr(strategy, name)]
    if not names:
        do = "Install lerobot>=0.6.1,<0.7."
        raise ContractError(expected("LeRobot's rollout", RETURN_MOTIONS, "neither", do))
    for name in names:
        if getattr(strategy, name) is not _no_return_motion:
            _replaced.append((strategy, name, inspect.getattr_static(strategy, name)))
            setattr(strategy, name, staticmethod(_no_return_motion))
    return True


def allow_return_motion() -> None:
    """Give LeRobot its own return motion back, for other robots."""
    while _replaced:
        strategy, name, motion = _replaced.pop()
        setattr(strategy, name, motion)


def _no_return_motion(*_: object, **__: object) -> bool:
    """Move nothing; False: LeRobot's main asks whether the start was reached."""
    log.info("uniforce_franka stays where it is: no motion after the end")
    return False


class UniforceFranka(Robot):
    """A Franka arm under Cartesian impedance control, with its hand and cameras.

    Actions are absolute targets, base frame, as in ``keys.AXES``: x, y, z m, yaw rad, width m. Each
    passes the guards, becomes a ramp at 100 Hz, and pulls through a clipped spring. Any fault ends
    the motion of arm and hand; only ``recover`` allows it again. Only ``connect``, ``recover`` and
    ``disconnect`` wait.
    """

    config_class = UniforceFrankaConfig
    name = "uniforce_franka"
    is_calibrated = True  # the arm knows its joints
    action_features = dict.fromkeys(AXES, float)  # the target axes

    _stream: ArmStream | None = None  # the finaliser also runs where the constructor failed

    def __init__(
        self, config: UniforceFrankaConfig, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(config)
        # checks it again: a field may have been set since it was made
        self.config = config = replace(config)
        self._clock = clock
        self.cameras = make_cameras_from_configs(config.cameras)
        self.guards = GuardChain(config.guards)
        self._arm, self._hand_client = make_backend(config)
        self._hand: Hand | None = None
        # LeRobot's own cameras, watched from the connection on
        self._plain: dict[str, PlainCamera] = {}
        self._fault: RobotError | None = None
        self._force_sensor: Any = None  # ForceSensor; read into the state
        if config.touch_in_state:
            from uniforce_vtla.force_sensor import ForceSensor

            if config.right_finger is None:
                wanted = "a tactile camera with finger: right"
                do = "Name it, or leave touch_in_state out."
                raise ContractError(expected("cameras", wanted, sorted(config.cameras), do))

            kind = config.fingers[config.right_finger].sensor
            calibration = config.right_calibration or None
            self._force_sensor = ForceSensor(kind, "right", calibration=calibration)

    @property
    def observation_features(self) -> dict[str, Any]:
        """Five measured axes, (height, width, 3) for each camera and each finger's reference.

        With ``touch_in_state`` the right finger's newtons instead of the fingers' images.
        """
        features: dict[str, Any] = dict.fromkeys(AXES, float)
        if self._force_sensor is not None:
            features |= dict.fromkeys(force_axes("right"), float)
        for name, camera in self.config.cameras.items():
            if name in self._shown:
                features[name] = (camera.height, camera.width, 3)
                if name in self.config.fingers:
                    features[f"{name}_ref"] = features[name]
        return features

    @property
    def _shown(self) -> list[str]:
        """Names of the cameras whose pictures are part of the observation."""
        if self._force_sensor is None:
            return list(self.config.cameras)
        return [name for name in self.config.cameras if name not in self.config.fingers]

    @property
    def is_connected(self) -> bool:
        """Whether arm, hand and cameras are; a fault does not disconnect, to keep its data."""
        return self._stream is not None

    def calibrate(self) -> None:
        """Do nothing: the hand is homed in Desk, since that moves the fingers."""

    configure = calibrate

    def connect(self, calibrate: bool = True) -> None:
        """Connect arm, hand and cameras. Nothing moves before the first action.

        Raises RobotError: already connected, no answer in time, wrong version, no client installed;
        SensorError: a camera or finger without signal, another sensor than configured, or no free
        air for its reference; ContractError: a LeRobot with an unknown return motion.
        """
        if self.is_connected:
            raise RobotError(
                "robot: expected one not connected, got one that is. Disconnect first.", "other"
            )
        CONNECTED.add(self)
        try:
            forbid_return_motion()
            self._connect_all()
        finally:
            if self._stream is None:  # something on the way failed, cameras included
                self.disconnect()

    def _connect_all(self) -> None:
        self._arm.connect()
        self._hand = hand = Hand(self._hand_client, self.config.gripper, self._clock)
        hand.start()
        if any(finger.reference_on_connect for finger in self.config.fingers.values()):
            require_open(hand.reading, self.config.open_width_m)
        for name, camera in self.cameras.items():
            self._connect_camera(name, camera)
        self._start_stream(hand)

    def _connect_camera(self, name: str, camera: Camera) -> None:
        if not isinstance(camera, SampledCamera):
            self._plain[name] = PlainCamera(name, camera)
        try:
            camera.connect()
        except UniForceError:
            raise
        except Exception as error:  # foreign code, which may raise anything
            do = "Check cable, permissions and settings."
            raise SensorError(expected(name, "a camera that connects", repr(error), do)) from error

    def require_open_hand(self) -> None:
        """Refuse a free-air reference while the fingers may hold something.

        Raises SensorError: the hand is not open; RobotError: a fault of the hand, or not connected.
        """
        require_open(self._parts()[1].reading, self.config.open_width_m)

    def _start_stream(self, hand: Hand) -> None:
        settings = replace(self.config.stream, action_period_s=1 / self.config.fps)
        stream = ArmStream(self._arm, settings, self.config.guards, hand, self._clock)
        stream.start()
        self._stream = stream
        self._fault = None
        self.guards.reset()

    def recover(self) -> None:
        """Clear a reflex on an operator's word. Nothing moves; targets start from where it is.

        Raises RobotError: the cause is still there (a pressed stop, a hand that is gone), or not
        connected.
        """
        stream, hand = self._parts()
        stream.stop()  # first: its thread ticks the hand
        hand.recover()
        self._arm.recover()
        self._start_stream(hand)

    def disconnect(self) -> None:
        """Stop arm and fingers where they are, join every thread, hang up. Safe to call twice."""
        counts = self.guard_counts
        stream, self._stream, self._hand = self._stream, None, None
        # last in, first out, and each of them even if another one fails
        with ExitStack() as closing:
            closing.callback(log.info, "guards acted: %s", counts)
            CONNECTED.discard(self)
            if not CONNECTED:
                closing.callback(allow_return_motion)
            for camera in self.cameras.values():
                if camera.is_connected:
                    closing.callback(camera.disconnect)
            closing.callback(self._arm.close)
            closing.callback(self._hand_client.close)
            if stream is not None:
                closing.callback(stream.stop)

    def __del__(self) -> None:
        """Let go of an arm that was dropped while connected, without waiting for its thread.

        The collector may run inside ``Thread.start``, under a lock that joining takes. LeRobot's
        own finaliser disconnects, and would wait for itself.
        """
        stream, self._stream = self._stream, None
        if stream is not None:
            text = "robot: expected disconnect() before it was dropped, got none."
            stream.halt(RobotError(f"{text} Use it as a context manager.", "ended"))
            self._hand_client.close()
            self._arm.close()

    def measured(self) -> np.ndarray:
        """Return (5,) where the robot is, axes as in ``keys.AXES``. Never blocks.

        Raises RobotError: not connected, a fault of arm or hand, or a reading too old.
        """
        stream, hand = self._parts()
        pose = ToolPose.from_ee(stream.state.ee_to_base)
        return np.array([*pose.position_m, pose.yaw_rad, hand.reading.width_m])

    @property
    def reading(self) -> tuple[ArmState, HandReading]:
        """The newest readings of arm and hand. Never blocks; raises RobotError: as ``measured``."""
        stream, hand = self._parts()
        return stream.state, hand.reading

    def stored_facts(self) -> dict[str, Any]:
        """Return the robot's lasting settings as found when connecting, as JSON values."""
        setup = self._arm.setup
        if setup is None:
            return {}
        return {
            "flange_to_ee": setup.flange_to_ee.round(5).tolist(),
            "load_kg": round(setup.load_kg, 3),
        }

    @property
    def guard_counts(self) -> dict[str, int]:
        """How often each guard acted so far; ``watchdog`` since the last connect."""
        watchdog = 0 if self._stream is None else self._stream.stale_count
        return {**self.guards.counts, "watchdog": watchdog}

    def get_observation(self) -> dict[str, Any]:
        """Return the measured axes and the newest image of each camera.

        Raises RobotError: a fault of arm or hand; SensorError: a camera or finger that is lost,
        stale, frozen or broken; arm and hand have stopped.
        """
        with self._halting():
            axes = by_axis(self.measured())
        images = {name: self._image(name, camera) for name, camera in self.cameras.items()}
        if self._force_sensor is not None:
            forces = self._forces(images)
            return {**axes, **forces, **{name: images[name] for name in self._shown}}
        for name in self.config.fingers:  # copies: what LeRobot gets it may write to
            images[f"{name}_ref"] = self.cameras[name].reference_image().copy()
        return {**axes, **images}

    def _forces(self, images: dict[str, np.ndarray]) -> dict[str, float]:
        """Return the right finger's newtons by axis; an error stops the robot."""
        name = self.config.right_finger
        assert name is not None, "the settings were checked"
        reference = np.ascontiguousarray(self.cameras[name].reference_image()[..., 0])
        try:
            force_N = self._force_sensor.read_forces(reference, images[name][None, ..., 0])[0]
        except UniForceError as error:
            self.guards.counts["sensor"] += 1
            self._halt(RobotError(f"{name}: {error}", "sensor"))
            raise
        return dict(zip(force_axes("right"), force_N.tolist(), strict=True))

    def _image(self, name: str, camera: Camera) -> np.ndarray:
        try:
            if name in self._plain:
                return self._plain[name].picture().image
            image: np.ndarray = camera.read_latest()
        except UniForceError as error:
            self.guards.counts["sensor"] += 1
            log.warning("guard sensor: %s: %s", name, error)
            self._halt(RobotError(f"{name}: {error}", "sensor"))
            raise
        return image

    def hold(self) -> None:
        """Let arm and hand rest where they are, at once; later actions are taken."""
        if self._stream is not None:
            self._stream.hold()
        self.guards.reset()

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Guard an action and make it the target; return what was sent. Never blocks.

        Raises RobotError: an axis is missing or no finite number, or the robot has a fault. The arm
        rests then, and every action is refused until ``recover``.
        """
        with self._halting():
            sent = self._send(action)
        return by_axis(sent)

    def _send(self, action: dict[str, Any]) -> np.ndarray:
        if self._fault is not None:
            raise self._fault
        stream, hand = self._parts()
        hand.check()
        missing = [axis for axis in AXES if axis not in action]
        if missing:
            raise RobotError(
                expected("action", AXES, f"{missing} missing", "Send all five."), "action"
            )
        wanted = np.array([_number(axis, action[axis]) for axis in AXES])
        measured = self.measured()
        rest = stream.resting
        if rest is not None:  # what was sent before the rest is no place to go on from
            self.guards.start_from(np.array([*rest.position_m, rest.yaw_rad, measured[4]]))
        sent = self.guards(wanted, measured, self._clock())
        stream.submit(ToolPose(sent[:3], float(sent[3])))
        hand.submit(float(sent[4]))
        return sent

    @contextmanager
    def _halting(self) -> Iterator[None]:
        """Let nothing that is raised leave the arm pulling at its last target."""
        try:
            yield
        except RobotError as fault:
            self._halt(fault)
            raise
        except Exception as error:  # whatever a policy hands over: the arm must not go on
            do = "The policy or the teleoperator is broken; the robot stops."
            broken = RobotError(
                expected("action", "five numbers by name", repr(error), do), "action"
            )
            self._halt(broken)
            raise broken from error
        except BaseException:  # Ctrl-C
            self.hold()
            raise

    def _halt(self, fault: RobotError) -> None:
        """Latch a fault; the stream's thread lets go of the arm, and no caller waits for it."""
        if self._stream is not None and self._fault is None:
            self._fault = fault
            self._stream.halt(fault)

    def _parts(self) -> tuple[ArmStream, Hand]:
        if self._stream is None or self._hand is None:
            raise RobotError("robot: expected a connected one, got none. Call connect().", "ended")
        return self._stream, self._hand


def _number(axis: str, value: Any) -> float:
    """Return a number, also of a tensor of one; a text that reads like one is none."""
    if isinstance(value, bool | str | bytes):
        raise RobotError(
            expected(axis, "a number", reprlib.repr(value), "The robot stops."), "action"
        )
    if hasattr(value, "item"):
        value = value.item()
    number = float(value)
    if not math.isfinite(number):
        raise RobotError(expected(axis, "a finite number", number, "The robot stops."), "action")
    return number
