"""Steer with a GELLO: its joints give a pose by the Franka's kinematics. Never run on hardware.

It is a chain of Dynamixel motors on a serial port, asked for its positions over and over. The
packets are those of the maker's ``dynamixel-sdk`` (extra ``gello``), which also lies below
LeRobot's own bus; LeRobot's layer says only in words whether an answer was missing or broken.
"""

import contextlib
import struct
import termios
import time
from dataclasses import dataclass, field

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.fr3 import HAND_TO_FLANGE, JOINTS, posture
from uniforce_robots.franka.poses import ToolPose
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader, SampleSource, Stamped, now_ns
from uniforce_robots.teleop.base import UniforceTeleoperator, gap_sizes, require_near
from uniforce_robots.teleop.integrator import SteeringConfig, TargetLimits
from uniforce_vtla.errors import ContractError, TeleoperatorError, expected

PRESENT_POSITION = 132  # control table of the X series
POSITION_BYTES = 4
COUNTS_PER_TURN = 4096
READ_TIMEOUT_S = 0.005  # the SDK asks without a pause otherwise, and takes a core while it waits
FAILED_IN_A_ROW = 5
REST_S = 0.002  # between two questions, so that a fast bus doesn't take a core: some 200 Hz
STALE_MS = 150.0  # an older reading is not followed
JUMP_rad = 0.35  # a joint that turns further between two readings has slipped or lies
MOVED = 0.01, 0.05, 0.005  # m, rad and m of width, beyond which it was moved since the start
# A GELLO that lies still repeats itself: that is no fault.
LIMITS = ReaderLimits(capacity=64, frozen_after=0, first_ms=2000.0, silent_s=1.0)
# TypeError: pyserial's descriptor vanished while it read
_BROKEN = (OSError, termios.error, TypeError)


@TeleoperatorConfig.register_subclass("uniforce_gello")
@dataclass(kw_only=True)
class UniforceGelloConfig(SteeringConfig):
    """A GELLO: a small arm of Dynamixel motors with the Franka's proportions."""

    limits: TargetLimits = field(
        default_factory=lambda: TargetLimits(speed=(0.2, 0.2, 0.2, 1.2, 0.1))
    )
    port: str = ""  # serial port, e.g. /dev/serial/by-id/usb-FTDI_…
    baud: int = 57_600  # as the motors come; GELLO builds often set 1_000_000
    # of the motors: seven joints and the gripper's trigger
    ids: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)
    signs: tuple[int, ...] = (1, 1, 1, 1, 1, 1, 1)  # joint = sign × (motor − offset)
    offsets_rad: tuple[float, ...] = (0.0,) * 7  # ``gello.offsets`` finds them from a held posture
    # motor angle of the trigger when open and when pulled
    trigger_rad: tuple[float, float] = (0.0, 0.7)
    width_m: tuple[float, float] = (0.08, 0.0)  # of the fingers when open and when pulled
    flange_to_tool_m: float = float(HAND_TO_FLANGE[2, 3])  # the point between the finger tips


def tool_axes(q_rad: np.ndarray, flange_to_tool_m: float) -> np.ndarray:
    """Return (4,) x, y, z m and yaw rad of the tool at joint angles (7,); its tilt is dropped."""
    hand = HAND_TO_FLANGE.copy()
    hand[2, 3] = flange_to_tool_m
    pose = ToolPose.from_ee(posture(q_rad).flange_to_base @ hand)
    return np.array([*pose.position_m, pose.yaw_rad])


def offsets(motor_rad: np.ndarray, signs: np.ndarray, held_rad: np.ndarray) -> np.ndarray:
    """Return the (7,) offsets, multiples of a quarter turn, of a GELLO held in a known posture.

    Motors are mounted at quarter turns, so rounding removes the error of the held posture.
    """
    return np.round((motor_rad - signs * held_rad) / (np.pi / 2)) * (np.pi / 2)


class GelloBus(SampleSource):
    """Motor angles (N,) rad, in the order of ``ids``; a reading without all motors is dropped.

    ``counts`` has whole readings, incomplete readings, broken packets.
    """

    def __init__(self, port: str, ids: tuple[int, ...], baud: int) -> None:
        super().__init__(f"gello ({port})")
        self._port = port
        self._ids = tuple(ids)
        self._baud = baud
        self._failed_in_a_row = 0

    def _connect(self, undo: contextlib.ExitStack) -> None:
        """Open the port for ourselves; TeleoperatorError: ``dynamixel-sdk`` is not installed."""
        try:
            from dynamixel_sdk import GroupSyncRead, PacketHandler, PortHandler
        except ImportError as error:
            do = 'Install it: pip install "lerobot[dynamixel]".'
            raise TeleoperatorError(
                expected(self.name, "dynamixel-sdk", error, do), "missing"
            ) from error
        self._failed_in_a_row = 0
        self._handler = PortHandler(self._port)
        undo.callback(self._stop)
        do = "Check the cable, permissions (group dialout), and that no other program holds it."
        try:
            if not self._handler.setBaudRate(self._baud):
                raise LostSensorError(
                    expected(self.name, "a baud rate of the motors", self._baud, do)
                )
            self._handler.ser.timeout = READ_TIMEOUT_S
            self._handler.ser.exclusive = True
        except (*_BROKEN, ValueError) as error:
            raise LostSensorError(expected(self.name, "a serial port", error, do)) from error
        self._group = GroupSyncRead(
            self._handler, PacketHandler(2.0), PRESENT_POSITION, POSITION_BYTES
        )
        for motor in self._ids:
            self._group.addParam(motor)

    def _stop(self) -> None:
        with contextlib.suppress(*_BROKEN):  # gone already; its descriptor is released anyway
            if self._handler.ser is not None:
                self._handler.closePort()

    def read(self) -> list[Stamped]:
        """Ask once; return the angles if every motor answered."""
        time.sleep(REST_S)
        answers = self._group.data_dict
        answers.update(dict.fromkeys(self._ids, b""))
        try:
            self._handler.ser.reset_input_buffer()  # late answers belong to the last question
            result = self._group.txRxPacket()
        except _BROKEN as error:
            raise LostSensorError(
                expected(self.name, "a working port", error, "Was it unplugged?")
            ) from error
        if any(len(answers[motor]) != POSITION_BYTES for motor in self._ids):
            self._count_failure(result, [motor for motor in self._ids if not answers[motor]])
            return []
        self._failed_in_a_row = 0
        self.counts.samples += 1
        counts = [struct.unpack("<i", bytes(answers[motor]))[0] for motor in self._ids]
        return [Stamped(now_ns(), np.array(counts) * (2 * np.pi / COUNTS_PER_TURN))]

    def _count_failure(self, result: int, missing: list[int]) -> None:
        """Raise where motors were missing several times in a row."""
        from dynamixel_sdk import COMM_RX_TIMEOUT

        is_silent = result == COMM_RX_TIMEOUT
        self.counts.lost += 1
        self.counts.bad += not is_silent
        self._failed_in_a_row += 1
        if self._failed_in_a_row < FAILED_IN_A_ROW:
            return
        if is_silent and len(missing) == len(self._ids):
            raise LostSensorError(
                expected(self.name, "answers", "none", "Is it powered, and is the baud rate right?")
            )
        do = "Check the chain's cables from the first missing motor on."
        wanted = f"answers of motors {list(self._ids)}"
        came = f"none whole from {missing}"
        raise ProtocolError(expected(self.name, wanted, came, do))


class UniforceGello(UniforceTeleoperator):
    """The target follows the GELLO's pose at limited speed; the trigger is the width.

    A start needs an aligned GELLO; what is left between them closes once it has been moved, not
    before.
    """

    config_class = UniforceGelloConfig
    name = "uniforce_gello"

    def __init__(self, config: UniforceGelloConfig) -> None:
        super().__init__(config)
        came = len(config.ids), len(config.signs), len(config.offsets_rad)
        if came != (JOINTS + 1, JOINTS, JOINTS):
            wanted = f"{JOINTS + 1}, {JOINTS}, {JOINTS} ids, signs and offsets"
            do = "Seven joints and the trigger; signs and offsets of the joints."
            raise ContractError(expected("gello", wanted, came, do))
        self.device = SampleReader(GelloBus(config.port, config.ids, config.baud), LIMITS)
        self._last: np.ndarray | None = None
        self._start: np.ndarray | None = None  # its pose at the start, until it has left that

    def _begin(self, measured: np.ndarray) -> None:
        self._last = None
        self._start = self._pose()
        require_near(self.name, self._start, measured)

    def _next(self, elapsed_s: float) -> np.ndarray:
        pose = self._pose()
        if self._start is not None and not np.greater(gap_sizes(pose - self._start), MOVED).any():
            return self.integrator.target
        self._start = None
        return self.integrator.towards(pose, elapsed_s, self.measured)

    def _pose(self) -> np.ndarray:
        """Return (5,) where the GELLO is, as the robot's axes."""
        q, trigger_rad = self._joints_and_trigger()
        if self._last is None:
            self._last = q
        turn_rad = np.abs(q - self._last)
        self._last = q
        if turn_rad.max() > JUMP_rad:
            what = f"{self.name}, joint {int(turn_rad.argmax()) + 1}"
            wanted = f"less than {JUMP_rad} rad between two readings"
            do = "Check horn and cable of the joint, then start again."
            raise TeleoperatorError(expected(what, wanted, f"{turn_rad.max():.2f}", do), "garbage")
        by_angle = np.array(sorted(zip(self.config.trigger_rad, self.config.width_m, strict=True)))
        width_m = np.interp(trigger_rad, by_angle[:, 0], by_angle[:, 1])
        return np.array([*tool_axes(q, self.config.flange_to_tool_m), width_m])

    def _joints_and_trigger(self) -> tuple[np.ndarray, float]:
        motors = self.device.newest(STALE_MS).raw
        q_rad: np.ndarray = motors[:JOINTS] - np.array(self.config.offsets_rad)
        return np.array(self.config.signs) * q_rad, float(motors[JOINTS])
