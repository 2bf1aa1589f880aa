"""Bytes ↔ dataclasses of the FCI version 10 (arm) and Hand version 3 wire protocols: pure functions only.

Source: the public headers of frankarobotics/libfranka-common (service_types.h, rbk_types.h), cross-checked with two
real clients. Everything is little endian and packed. A TCP message is a header and a payload; the header's size
counts itself. States and commands of the control loop travel by UDP.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import IntEnum

import numpy as np

ARM_PORT, HAND_PORT = 1337, 1338
ARM_VERSION, HAND_VERSION = 10, 3
MAX_MESSAGE_BYTES = 1 << 20  # a header that announces more is garbage, not a message


class ProtocolError(ValueError):
    """Bytes that are no message of this protocol. Not one of the project's errors: those live beside torch."""

    def __init__(self, what: str, wanted: object, came: object) -> None:
        super().__init__(f"{what}: expected {wanted}, got {came}. Close the connection or drop the datagram.")


class ArmCommand(IntEnum):
    """TCP requests of the arm."""

    CONNECT = 0
    MOVE = 1
    STOP_MOVE = 2
    SET_COLLISION_BEHAVIOR = 3
    SET_JOINT_IMPEDANCE = 4
    SET_CARTESIAN_IMPEDANCE = 5
    SET_GUIDING_MODE = 6
    SET_EE_TO_K = 7
    SET_NE_TO_EE = 8
    SET_LOAD = 9
    AUTOMATIC_ERROR_RECOVERY = 10
    GET_ROBOT_MODEL = 11


class HandCommand(IntEnum):
    """TCP requests of the hand."""

    CONNECT = 0
    HOMING = 1
    GRASP = 2
    MOVE = 3
    STOP = 4


class MoveStatus(IntEnum):
    """Answers to Move: the first says that it started, the last one how it ended."""

    SUCCESS = 0
    MOTION_STARTED = 1
    PREEMPTED = 2
    NOT_POSSIBLE = 5
    INVALID_ARGUMENT = 7
    REFLEX_ABORTED = 8
    EMERGENCY_ABORTED = 9
    INPUT_ERROR = 10
    ABORTED = 11


class SetterStatus(IntEnum):
    """Answers to every request that only sets something."""

    SUCCESS = 0
    NOT_POSSIBLE = 1
    INVALID_ARGUMENT = 2


class HandStatus(IntEnum):
    """Answers of the hand."""

    SUCCESS = 0
    FAIL = 1
    UNSUCCESSFUL = 2  # done, yet nothing grasped or the width not reached
    ABORTED = 3


class ConnectStatus(IntEnum):
    """Answers to Connect, arm and hand."""

    SUCCESS = 0
    INCOMPATIBLE_VERSION = 1


class Generator(IntEnum):
    """Motion generator asked for by a Move; a state shows it plus one, 0 meaning idle."""

    JOINT_POSITION = 0
    JOINT_VELOCITY = 1
    CARTESIAN_POSITION = 2
    CARTESIAN_VELOCITY = 3
    NONE = 4


class Controller(IntEnum):
    """Controller asked for by a Move; ``OTHER`` is only seen in states."""

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2
    OTHER = 3


class RobotMode(IntEnum):
    """What the arm is doing."""

    OTHER = 0
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


class ErrorBit(IntEnum):
    """Positions in a state's 41 error flags, those this stand-in raises; ``COMMAND``: by a motion generator."""

    JOINT_POSITION_LIMITS_VIOLATION = 0
    JOINT_VELOCITY_VIOLATION = 3
    CARTESIAN_VELOCITY_VIOLATION = 4
    JOINT_REFLEX = 6
    CARTESIAN_REFLEX = 7
    JOINT_POSITION_START_POSE_INVALID = 11
    JOINT_COMMAND_VELOCITY_LIMITS = 13
    JOINT_COMMAND_VELOCITY_DISCONTINUITY = 14
    CARTESIAN_POSITION_START_POSE_INVALID = 16
    CARTESIAN_COMMAND_VELOCITY_LIMITS = 18
    CARTESIAN_COMMAND_VELOCITY_DISCONTINUITY = 19
    COMMUNICATION_CONSTRAINTS_VIOLATION = 25
    POWER_LIMIT_VIOLATION = 26
    CARTESIAN_COMMAND_INVALID_FRAME = 31
    CONTROLLER_TORQUE_DISCONTINUITY = 32
    TAU_J_RANGE_VIOLATION = 34


ERRORS = 41

# --- TCP -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Message:
    """One TCP message: a request or an answer."""

    command: int
    command_id: int
    payload: bytes = b""


@dataclass(frozen=True)
class Header:
    """Layout of a protocol's TCP header: command, command id, total size."""

    layout: struct.Struct
    device: str

    def encode(self, message: Message) -> bytes:
        """Return the message's bytes."""
        size = self.layout.size + len(message.payload)
        return self.layout.pack(message.command, message.command_id, size) + message.payload

    def decode(self, buffer: bytes) -> tuple[Message | None, bytes]:
        """Return the first whole message of a buffer (None while it is incomplete) and the bytes after it.

        Raises:
            ProtocolError: the announced size is smaller than a header or absurdly large.
        """
        if len(buffer) < self.layout.size:
            return None, buffer
        command, command_id, size = self.layout.unpack_from(buffer)
        if not self.layout.size <= size <= MAX_MESSAGE_BYTES:
            wanted = f"{self.layout.size} to {MAX_MESSAGE_BYTES} bytes"
            raise ProtocolError(f"{self.device} message size", wanted, size)
        if len(buffer) < size:
            return None, buffer
        return Message(command, command_id, buffer[self.layout.size : size]), buffer[size:]


ARM_HEADER = Header(struct.Struct("<III"), "arm")
HAND_HEADER = Header(struct.Struct("<HII"), "hand")


def unpack(layout: struct.Struct, payload: bytes, what: str) -> tuple:
    """Return a payload's values.

    Raises:
        ProtocolError: the payload has another size.
    """
    if len(payload) != layout.size:
        raise ProtocolError(f"{what} payload", f"{layout.size} bytes", len(payload))
    return layout.unpack(payload)


def numbers(payload: bytes, count: int, what: str) -> np.ndarray:
    """Return a payload of ``count`` float64.

    Raises:
        ProtocolError: another size, or a number that is not finite.
    """
    if len(payload) != 8 * count:
        raise ProtocolError(f"{what} payload", f"{8 * count} bytes", len(payload))
    values = np.frombuffer(payload, "<f8").copy()
    if not np.isfinite(values).all():
        raise ProtocolError(what, "finite numbers", "NaN or inf")
    return values


@dataclass(frozen=True)
class ConnectRequest:
    """Who wants to talk, and where to send states."""

    version: int
    udp_port: int

    LAYOUT = struct.Struct("<HH")

    def encode(self) -> bytes:
        """Return the payload."""
        return self.LAYOUT.pack(self.version, self.udp_port)

    @classmethod
    def decode(cls, payload: bytes) -> ConnectRequest:
        """Return the request; raise ProtocolError for another size."""
        return cls(*unpack(cls.LAYOUT, payload, "Connect"))


@dataclass(frozen=True)
class MoveRequest:
    """Start of a motion: which controller and generator; the deviations are limits in m, rad, rad."""

    controller: Controller
    generator: Generator
    path_deviation: tuple[float, float, float] = (10.0, 3.12, 2 * np.pi)
    goal_deviation: tuple[float, float, float] = (10.0, 3.12, 2 * np.pi)
    asynchronous: bool = False
    max_velocity_rad_s: tuple[float, ...] = (2.0,) * 7

    LAYOUT = struct.Struct("<II3d3d?7d")

    def encode(self) -> bytes:
        """Return the 113-byte payload."""
        deviations = (*self.path_deviation, *self.goal_deviation)
        head = (self.controller, self.generator)
        return self.LAYOUT.pack(*head, *deviations, self.asynchronous, *self.max_velocity_rad_s)

    @classmethod
    def decode(cls, payload: bytes) -> MoveRequest:
        """Return the request.

        Raises:
            ProtocolError: another size, or a controller or generator nobody knows.
        """
        values = unpack(cls.LAYOUT, payload, "Move")
        if values[0] > Controller.EXTERNAL or values[1] > Generator.NONE:
            came = f"{values[0]} and {values[1]}"
            raise ProtocolError("Move controller and generator", "≤ 2 and ≤ 4", came)
        modes = (Controller(values[0]), Generator(values[1]))
        return cls(*modes, values[2:5], values[5:8], values[8], values[9:16])


@dataclass(frozen=True)
class CollisionBehavior:
    """Thresholds above which the arm reports contact (lower) or stops by reflex (upper): Nm (7,), N and Nm (6,)."""

    lower_torque_acceleration: np.ndarray
    upper_torque_acceleration: np.ndarray
    lower_torque_nominal: np.ndarray
    upper_torque_nominal: np.ndarray
    lower_force_acceleration: np.ndarray
    upper_force_acceleration: np.ndarray
    lower_force_nominal: np.ndarray
    upper_force_nominal: np.ndarray

    def encode(self) -> bytes:
        """Return the 416-byte payload."""
        return np.concatenate([getattr(self, f.name) for f in fields(self)]).astype("<f8").tobytes()

    @classmethod
    def decode(cls, payload: bytes) -> CollisionBehavior:
        """Return the thresholds; raise ProtocolError for another size or numbers that are not finite."""
        values = numbers(payload, 52, "SetCollisionBehavior")
        return cls(*np.split(values, [7, 14, 21, 28, 34, 40, 46]))


@dataclass(frozen=True)
class Load:
    """A payload: kg, centre of mass in the flange frame in m, inertia in kg m² (column-major)."""

    mass_kg: float
    center_m: np.ndarray
    inertia_kgm2: np.ndarray

    def encode(self) -> bytes:
        """Return the 104-byte payload."""
        return np.concatenate([[self.mass_kg], self.center_m, self.inertia_kgm2]).astype("<f8").tobytes()

    @classmethod
    def decode(cls, payload: bytes) -> Load:
        """Return the load; raise ProtocolError for another size or numbers that are not finite."""
        values = numbers(payload, 13, "SetLoad")
        return cls(float(values[0]), values[1:4], values[4:])


GUIDING = struct.Struct("<7?")  # x, y, z, roll, pitch, yaw, elbow
JOINT_IMPEDANCE_COUNT, CARTESIAN_IMPEDANCE_COUNT, TRANSFORM_COUNT = 7, 6, 16

# --- UDP of the arm --------------------------------------------------------------------------------------------------

STATE_FLOATS = {
    "O_T_EE": 16,
    "O_T_EE_d": 16,
    "F_T_EE": 16,
    "EE_T_K": 16,
    "F_T_NE": 16,
    "NE_T_EE": 16,
    "m_ee": 1,
    "I_ee": 9,
    "F_x_Cee": 3,
    "m_load": 1,
    "I_load": 9,
    "F_x_Cload": 3,
    "elbow": 2,
    "elbow_d": 2,
    "tau_J": 7,
    "tau_J_d": 7,
    "dtau_J": 7,
    "q": 7,
    "q_d": 7,
    "dq": 7,
    "dq_d": 7,
    "ddq_d": 7,
    "joint_contact": 7,
    "cartesian_contact": 6,
    "joint_collision": 7,
    "cartesian_collision": 6,
    "tau_ext_hat_filtered": 7,
    "O_F_ext_hat_K": 6,
    "K_F_ext_hat_K": 6,
    "O_dP_EE_d": 6,
    "O_ddP_O": 3,
    "elbow_c": 2,
    "delbow_c": 2,
    "ddelbow_c": 2,
    "O_T_EE_c": 16,
    "O_dP_EE_c": 6,
    "O_ddP_EE_c": 6,
    "theta": 7,
    "dtheta": 7,
    "accelerometer_top": 18,
    "accelerometer_bottom": 18,
}
_ENDS = np.cumsum(list(STATE_FLOATS.values()))
STATE_SLICES = {
    name: slice(int(end) - size, int(end))
    for (name, size), end in zip(STATE_FLOATS.items(), _ENDS, strict=True)
}
STATE_FLOAT_COUNT = int(_ENDS[-1])  # 320
_STATE_HEAD, _STATE_TAIL = struct.Struct("<Q"), struct.Struct("<BB41s41sBf")
STATE_BYTES = _STATE_HEAD.size + 4 * STATE_FLOAT_COUNT + _STATE_TAIL.size  # 1377


@dataclass(frozen=True)
class RobotState:
    """What the arm says of itself, once a millisecond. 4×4 matrices are column-major.

    Attributes:
        message_id: the robot's milliseconds; a command echoes it.
        floats: (320,) float32, cut by ``STATE_SLICES``.
        generator: 0 when idle, otherwise ``Generator`` + 1.
        controller: a ``Controller``.
        errors: (41,) flags of what is wrong now.
        reflex_reason: (41,) flags of what caused the last reflex.
        mode: a ``RobotMode``.
        success_rate: share of the last 100 commands that arrived in time.
    """

    message_id: int
    floats: np.ndarray
    generator: int = 0
    controller: int = Controller.OTHER
    errors: frozenset[int] = frozenset()
    reflex_reason: frozenset[int] = frozenset()
    mode: int = RobotMode.IDLE
    success_rate: float = 0.0

    def __getitem__(self, name: str) -> np.ndarray:
        return self.floats[STATE_SLICES[name]]

    def encode(self) -> bytes:
        """Return the 1377-byte datagram."""
        tail = (self.generator, self.controller, _flags(self.errors), _flags(self.reflex_reason))
        body = np.asarray(self.floats, "<f4").tobytes()
        return (
            _STATE_HEAD.pack(self.message_id) + body + _STATE_TAIL.pack(*tail, self.mode, self.success_rate)
        )

    @classmethod
    def decode(cls, datagram: bytes) -> RobotState:
        """Return the state; raise ProtocolError for another size."""
        if len(datagram) != STATE_BYTES:
            raise ProtocolError("RobotState", f"{STATE_BYTES} bytes", len(datagram))
        (message_id,) = _STATE_HEAD.unpack_from(datagram)
        floats = np.frombuffer(datagram, "<f4", STATE_FLOAT_COUNT, _STATE_HEAD.size).copy()
        tail = _STATE_TAIL.unpack_from(datagram, _STATE_HEAD.size + 4 * STATE_FLOAT_COUNT)
        generator, controller, errors, reflex, mode, rate = tail
        return cls(message_id, floats, generator, controller, _bits(errors), _bits(reflex), mode, rate)


def _flags(bits: frozenset[int]) -> bytes:
    return bytes(int(i in bits) for i in range(ERRORS)) if bits else bytes(ERRORS)


def _bits(flags: bytes) -> frozenset[int]:
    return frozenset(i for i, flag in enumerate(flags) if flag)


_COMMAND = struct.Struct("<Q7d7d16d6d2d??7d?")
COMMAND_BYTES = _COMMAND.size  # 371


def _zeros(n: int) -> Callable[[], np.ndarray]:
    return lambda: np.zeros(n)


@dataclass(frozen=True)
class RobotCommand:
    """What a client wants for the next millisecond. Only the field of the running generator counts."""

    message_id: int
    q_c: np.ndarray = field(default_factory=_zeros(7))  # rad
    dq_c: np.ndarray = field(default_factory=_zeros(7))  # rad/s
    O_T_EE_c: np.ndarray = field(default_factory=_zeros(16))  # column-major
    O_dP_EE_c: np.ndarray = field(default_factory=_zeros(6))  # m/s, rad/s
    elbow_c: np.ndarray = field(default_factory=_zeros(2))
    valid_elbow: bool = False
    motion_finished: bool = False
    tau_J_d: np.ndarray = field(default_factory=_zeros(7))  # Nm, without gravity
    torque_finished: bool = False

    @property
    def finished(self) -> bool:
        """Whether the client ends the motion with this command."""
        return self.motion_finished or self.torque_finished

    def encode(self) -> bytes:
        """Return the 371-byte datagram."""
        motion = (*self.q_c, *self.dq_c, *self.O_T_EE_c, *self.O_dP_EE_c, *self.elbow_c)
        flags = (self.valid_elbow, self.motion_finished)
        return _COMMAND.pack(self.message_id, *motion, *flags, *self.tau_J_d, self.torque_finished)

    @classmethod
    def decode(cls, datagram: bytes) -> RobotCommand:
        """Return the command.

        Raises:
            ProtocolError: another size, or a number that is not finite.
        """
        values = unpack(_COMMAND, datagram, "RobotCommand")
        floats = np.array([*values[1:39], *values[41:48]])
        if not np.isfinite(floats).all():
            raise ProtocolError("RobotCommand", "finite numbers", "NaN or inf")
        q, dq, pose, twist, elbow, tau = np.split(floats, [7, 14, 30, 36, 38])
        return cls(values[0], q, dq, pose, twist, elbow, values[39], values[40], tau, values[48])


# --- Hand ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class GraspRequest:
    """Close (or open) until ``force_N`` holds something between ``width − inner`` and ``width + outer``."""

    width_m: float
    inner_m: float
    outer_m: float
    speed_m_s: float
    force_N: float

    def encode(self) -> bytes:
        """Return the payload."""
        return struct.pack("<5d", self.width_m, self.inner_m, self.outer_m, self.speed_m_s, self.force_N)

    @classmethod
    def decode(cls, payload: bytes) -> GraspRequest:
        """Return the request; raise ProtocolError for another size or numbers that are not finite."""
        return cls(*numbers(payload, 5, "Grasp").tolist())


@dataclass(frozen=True)
class HandMoveRequest:
    """Go to a width."""

    width_m: float
    speed_m_s: float

    def encode(self) -> bytes:
        """Return the payload."""
        return struct.pack("<2d", self.width_m, self.speed_m_s)

    @classmethod
    def decode(cls, payload: bytes) -> HandMoveRequest:
        """Return the request; raise ProtocolError for another size or numbers that are not finite."""
        return cls(*numbers(payload, 2, "hand Move").tolist())


_HAND_STATE = struct.Struct("<IddBH")
HAND_STATE_BYTES = _HAND_STATE.size  # 23


@dataclass(frozen=True)
class HandState:
    """What the hand says of itself."""

    message_id: int
    width_m: float
    max_width_m: float
    is_grasped: bool
    temperature_C: int

    def encode(self) -> bytes:
        """Return the 23-byte datagram."""
        widths = (self.width_m, self.max_width_m)
        return _HAND_STATE.pack(self.message_id, *widths, self.is_grasped, self.temperature_C)

    @classmethod
    def decode(cls, datagram: bytes) -> HandState:
        """Return the state; raise ProtocolError for another size."""
        message_id, width, max_width, grasped, temperature = unpack(_HAND_STATE, datagram, "HandState")
        return cls(message_id, width, max_width, bool(grasped), temperature)
