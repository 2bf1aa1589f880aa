"""Bytes of the FCI version 10 (arm) and Hand version 3 wire protocols: pure functions only.

Source: the public headers of frankarobotics/libfranka-common (service_types.h, rbk_types.h),
checked with two real clients. Everything is little endian and packed. A TCP message is a header and
a payload; the header's size counts itself. States and commands of the control loop go by UDP.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np

ARM_PORT = 1337
HAND_PORT = 1338
ARM_VERSION = 10
HAND_VERSION = 3
MAX_MESSAGE_BYTES = 1 << 20  # a header that announces more is garbage, not a message


class ProtocolError(ValueError):
    """Bytes that are no message of this protocol. The project's own errors would load torch."""

    def __init__(self, what: str, wanted: object, came: object) -> None:
        super().__init__(
            f"{what}: expected {wanted}, got {came}. Close the connection or drop the datagram."
        )


# TCP requests of the arm and of the hand.
ArmCommand = IntEnum(
    "ArmCommand",
    "CONNECT MOVE STOP_MOVE SET_COLLISION_BEHAVIOR SET_JOINT_IMPEDANCE SET_CARTESIAN_IMPEDANCE "
    "SET_GUIDING_MODE SET_EE_TO_K SET_NE_TO_EE SET_LOAD AUTOMATIC_ERROR_RECOVERY GET_ROBOT_MODEL",
    start=0,
)
HandCommand = IntEnum("HandCommand", "CONNECT HOMING GRASP MOVE STOP", start=0)


class MoveStatus(IntEnum):
    """Answers to Move: the first says that it started, the last one how it ended."""

    SUCCESS = 0
    MOTION_STARTED = 1
    PREEMPTED = 2
    NOT_POSSIBLE = 5
    INVALID_ARGUMENT = 7
    REFLEX_ABORTED = 8
    EMERGENCY_ABORTED = 9
    ABORTED = 11


# Answers to every request that only sets something; those of the hand; and to Connect.
SetterStatus = IntEnum("SetterStatus", "SUCCESS NOT_POSSIBLE INVALID_ARGUMENT", start=0)
HandStatus = IntEnum("HandStatus", "SUCCESS FAIL UNSUCCESSFUL ABORTED", start=0)
ConnectStatus = IntEnum("ConnectStatus", "SUCCESS INCOMPATIBLE_VERSION", start=0)
# The torque control of a Move: controller, generator. The clients here use no other.
TORQUE_CONTROL = EXTERNAL, NO_GENERATOR = 2, 4
OTHER = 3  # the controller that a state names without a motion
RobotMode = IntEnum("RobotMode", "OTHER IDLE MOVE GUIDING REFLEX USER_STOPPED RECOVERY", start=0)


class ErrorBit(IntEnum):
    """Positions in a state's 41 error flags, those this stand-in raises."""

    JOINT_POSITION_LIMITS_VIOLATION = 0
    JOINT_VELOCITY_VIOLATION = 3
    CARTESIAN_VELOCITY_VIOLATION = 4
    JOINT_REFLEX = 6
    CARTESIAN_REFLEX = 7
    COMMUNICATION_CONSTRAINTS_VIOLATION = 25
    POWER_LIMIT_VIOLATION = 26
    CONTROLLER_TORQUE_DISCONTINUITY = 32
    TAU_J_RANGE_VIOLATION = 34


ERRORS = 41

# --- TCP --------------------------------------------------------------------------------------


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
        """Return a buffer's first whole message, None while incomplete, and the bytes after it.

        Raises ProtocolError: the announced size is smaller than a header or absurdly large.
        """
        if len(buffer) < self.layout.size:
            return None, buffer
        command, command_id, size = self.layout.unpack_from(buffer)
        if not self.layout.size <= size <= MAX_MESSAGE_BYTES:
            raise ProtocolError(
                f"{self.device} message size",
                f"{self.layout.size} to {MAX_MESSAGE_BYTES} bytes",
                size,
            )
        if len(buffer) < size:
            return None, buffer
        return Message(command, command_id, buffer[self.layout.size : size]), buffer[size:]


ARM_HEADER = Header(struct.Struct("<III"), "arm")
HAND_HEADER = Header(struct.Struct("<HII"), "hand")
CONNECT = struct.Struct("<HH")  # version, UDP port for the states
# controller, generator, two deviations m rad rad, asynchronous, speeds rad/s
MOVE = struct.Struct("<II3d3d?7d")
SETTERS = {  # layouts of their payloads
    # lower, upper: torque 7 7, nominal 7 7, force the same
    ArmCommand.SET_COLLISION_BEHAVIOR: "<52d",
    ArmCommand.SET_JOINT_IMPEDANCE: "<7d",
    ArmCommand.SET_CARTESIAN_IMPEDANCE: "<6d",
    ArmCommand.SET_GUIDING_MODE: "<7?",  # x, y, z, roll, pitch, yaw, elbow
    ArmCommand.SET_EE_TO_K: "<16d",
    ArmCommand.SET_NE_TO_EE: "<16d",
    ArmCommand.SET_LOAD: "<13d",  # mass kg, centre m, inertia kg m²
}
# of the collision behaviour: the nominal ones, above which the arm stops by reflex
UPPER_TORQUE = slice(21, 28)
UPPER_FORCE = slice(46, 52)


def unpack(layout: struct.Struct, payload: bytes, what: str) -> tuple:
    """Return a payload's values; raises ProtocolError: the payload has another size."""
    if len(payload) != layout.size:
        raise ProtocolError(f"{what} payload", f"{layout.size} bytes", len(payload))
    return layout.unpack(payload)


def numbers(layout: struct.Struct, payload: bytes, what: str) -> np.ndarray:
    """Return a payload's values as float64; raises ProtocolError: another size, or not finite."""
    values = np.array(unpack(layout, payload, what), float)
    if not np.isfinite(values).all():
        raise ProtocolError(what, "finite numbers", "NaN or inf")
    return values


class Grasp(NamedTuple):
    """Close (or open) until ``force_N`` holds something from width − inner to width + outer."""

    width_m: float
    inner_m: float
    outer_m: float
    speed_m_s: float
    force_N: float


class HandMove(NamedTuple):
    """Go to a width."""

    width_m: float
    speed_m_s: float


def decode_hand[Request: (Grasp, HandMove)](kind: type[Request], payload: bytes) -> Request:
    """Return a request of the hand; raise ProtocolError for another size or not finite numbers."""
    return kind(*numbers(struct.Struct(f"<{len(kind._fields)}d"), payload, kind.__name__).tolist())


# --- UDP --------------------------------------------------------------------------------------

# Names and numbers of float32, in the order of a state.
_LAYOUT = """
O_T_EE 16 O_T_EE_d 16 F_T_EE 16 EE_T_K 16 F_T_NE 16 NE_T_EE 16
m_ee 1 I_ee 9 F_x_Cee 3 m_load 1 I_load 9 F_x_Cload 3
elbow 2 elbow_d 2 tau_J 7 tau_J_d 7 dtau_J 7 q 7 q_d 7 dq 7 dq_d 7 ddq_d 7
joint_contact 7 cartesian_contact 6 joint_collision 7 cartesian_collision 6
tau_ext_hat_filtered 7 O_F_ext_hat_K 6 K_F_ext_hat_K 6 O_dP_EE_d 6 O_ddP_O 3
elbow_c 2 delbow_c 2 ddelbow_c 2 O_T_EE_c 16 O_dP_EE_c 6 O_ddP_EE_c 6 theta 7 dtheta 7
accelerometer_top 18 accelerometer_bottom 18
"""
_WORDS = _LAYOUT.split()
_NAMES = _WORDS[::2]
_SIZES = [int(size) for size in _WORDS[1::2]]
_ENDS = np.cumsum(_SIZES).tolist()
STATE_SLICES = {
    n: slice(end - size, end) for n, size, end in zip(_NAMES, _SIZES, _ENDS, strict=True)
}
STATE_FLOAT_COUNT = _ENDS[-1]  # 320
STATE = struct.Struct(f"<Q{4 * STATE_FLOAT_COUNT}sBB{ERRORS}s{ERRORS}sBf")  # 1377 bytes


@dataclass(frozen=True)
class RobotState:
    """State of the arm, once a millisecond. 4×4 matrices are column-major."""

    message_id: int  # the robot's milliseconds; a command echoes it
    floats: np.ndarray  # (320,) float32, cut by ``STATE_SLICES``
    generator: int  # 0 when idle, otherwise the Move's + 1
    controller: int  # the Move's
    errors: frozenset[int]  # of the 41 flags, those of what is wrong now
    reflex_reason: frozenset[int]  # those of what caused the last reflex
    mode: int
    success_rate: float  # share of the last 100 commands that arrived in time

    def __getitem__(self, name: str) -> np.ndarray:
        return self.floats[STATE_SLICES[name]]

    def encode(self) -> bytes:
        """Return the 1377-byte datagram."""
        body = np.asarray(self.floats, "<f4").tobytes()
        flags = (_flags(self.errors), _flags(self.reflex_reason))
        head = (self.message_id, body, self.generator, self.controller)
        return STATE.pack(*head, *flags, self.mode, self.success_rate)


def _flags(bits: frozenset[int]) -> bytes:
    flags = bytearray(ERRORS)
    for bit in bits:
        flags[bit] = 1
    return bytes(flags)


# id, what motion generators use, elbow valid, motion finished, torques, torque control finished
COMMAND = struct.Struct("<Q304x??7d?")


@dataclass(frozen=True)
class RobotCommand:
    """Command of a client for the next millisecond, under torque control."""

    message_id: int
    tau_J_d: np.ndarray = field(default_factory=lambda: np.zeros(7))  # Nm, without gravity
    finished: bool = False  # the client ends the motion with this command

    @classmethod
    def decode(cls, datagram: bytes) -> RobotCommand:
        """Return the command; raise ProtocolError: another size, or a torque not finite."""
        message_id, _, motion_finished, *tau, finished = unpack(COMMAND, datagram, "RobotCommand")
        if not np.isfinite(tau).all():
            raise ProtocolError("RobotCommand", "finite numbers", "NaN or inf")
        return cls(message_id, np.array(tau), motion_finished or finished)


HAND_STATE = struct.Struct("<IddBH")  # 23 bytes


class HandState(NamedTuple):
    """State of the hand."""

    message_id: int
    width_m: float
    max_width_m: float
    is_grasped: bool
    temperature_C: int

    def encode(self) -> bytes:
        """Return the 23-byte datagram."""
        return HAND_STATE.pack(*self)
