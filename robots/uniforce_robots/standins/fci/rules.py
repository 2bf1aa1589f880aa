"""What a real robot refuses in a client's commands, checked before the arm follows them.

The limits are those of the FR3 in Franka's interface specification and in libfranka's rate_limiting.h; how much a real
controller tolerates beyond them is not published, so a small share is allowed. Jerk is not checked.
"""

from __future__ import annotations

import numpy as np

from uniforce_robots.fr3 import JOINTS, DQ_MAX_rad_s, TAU_MAX_Nm, rotation_error
from uniforce_robots.standins.fci.arm import Arm, TICK_s
from uniforce_robots.standins.fci.protocol import ErrorBit, Generator, RobotCommand

TOLERANCE = 1.01  # states are float32, and a client's rounding is no fault
TORQUE_STEP_Nm = 1.0  # a millisecond: 1000 Nm/s
DDQ_MAX_rad_s2 = 10.0
SPEED_m_s, TURN_rad_s = 3.0, 2.5
ACCELERATION_m_s2, TURN_rad_s2 = 9.0, 17.0
PACKETS = 20  # so many lost ones are made up for by constant motion; more end it
ROUNDING = 1e-3


def broken_rules(
    command: RobotCommand, before: RobotCommand | None, generator: Generator, arm: Arm
) -> frozenset[int]:
    """Return the error bits of a command that follows on ``before`` (None: on rest, where the arm is)."""
    match generator:
        case Generator.NONE:
            bits = _torque(command, before)
        case Generator.JOINT_POSITION:
            bits = _joint_position(command, before, arm)
        case Generator.JOINT_VELOCITY:
            bits = _joint_velocity(command, before)
        case Generator.CARTESIAN_POSITION:
            bits = _pose(command, before, arm)
        case Generator.CARTESIAN_VELOCITY:
            bits = _twist(command, before)
    return frozenset(bits)


def _torque(command: RobotCommand, before: RobotCommand | None) -> set[int]:
    last = before.tau_J_d if before else np.zeros(JOINTS)
    bits: set[int] = set()
    if _beyond(command.tau_J_d - last, TORQUE_STEP_Nm):
        bits.add(ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY)
    if _beyond(command.tau_J_d, TAU_MAX_Nm):
        bits.add(ErrorBit.TAU_J_RANGE_VIOLATION)
    return bits


def _joint_position(command: RobotCommand, before: RobotCommand | None, arm: Arm) -> set[int]:
    step = command.q_c - (before.q_c if before else arm.q_rad)
    too_fast = _beyond(step, DQ_MAX_rad_s * _elapsed_s(command, before))
    start, later = ErrorBit.JOINT_POSITION_START_POSE_INVALID, ErrorBit.JOINT_COMMAND_VELOCITY_LIMITS
    return {later if before else start} if too_fast else set()


def _joint_velocity(command: RobotCommand, before: RobotCommand | None) -> set[int]:
    bits: set[int] = set()
    if _beyond(command.dq_c, DQ_MAX_rad_s):
        bits.add(ErrorBit.JOINT_COMMAND_VELOCITY_LIMITS)
    step = command.dq_c - (before.dq_c if before else 0.0)
    if _beyond(step, DDQ_MAX_rad_s2 * _elapsed_s(command, before)):
        bits.add(ErrorBit.JOINT_COMMAND_VELOCITY_DISCONTINUITY)
    return bits


def _pose(command: RobotCommand, before: RobotCommand | None, arm: Arm) -> set[int]:
    pose = command.O_T_EE_c.reshape(4, 4).T
    turn = pose[:3, :3]
    if np.abs(turn).max() > 1 + ROUNDING or np.abs(turn @ turn.T - np.eye(3)).max() > ROUNDING:
        return {ErrorBit.CARTESIAN_COMMAND_INVALID_FRAME}
    last = before.O_T_EE_c.reshape(4, 4).T if before else arm.ee_to_base
    elapsed_s = _elapsed_s(command, before)
    moved = _length_beyond(pose[:3, 3] - last[:3, 3], SPEED_m_s * elapsed_s)
    turned = _length_beyond(rotation_error(turn, last[:3, :3]), TURN_rad_s * elapsed_s)
    start, later = ErrorBit.CARTESIAN_POSITION_START_POSE_INVALID, ErrorBit.CARTESIAN_COMMAND_VELOCITY_LIMITS
    return {later if before else start} if moved or turned else set()


def _twist(command: RobotCommand, before: RobotCommand | None) -> set[int]:
    twist = command.O_dP_EE_c
    step = twist - (before.O_dP_EE_c if before else 0.0)
    elapsed_s = _elapsed_s(command, before)
    bits: set[int] = set()
    if _length_beyond(twist[:3], SPEED_m_s) or _length_beyond(twist[3:], TURN_rad_s):
        bits.add(ErrorBit.CARTESIAN_COMMAND_VELOCITY_LIMITS)
    linear = _length_beyond(step[:3], ACCELERATION_m_s2 * elapsed_s)
    if linear or _length_beyond(step[3:], TURN_rad_s2 * elapsed_s):
        bits.add(ErrorBit.CARTESIAN_COMMAND_VELOCITY_DISCONTINUITY)
    return bits


def _elapsed_s(command: RobotCommand, before: RobotCommand | None) -> float:
    """Return the time since the command before: the robot goes on by itself where packets are lost."""
    gap = command.message_id - before.message_id if before else 1
    return TICK_s * min(max(gap, 1), PACKETS)


def _beyond(values: np.ndarray, limit: np.ndarray | float) -> bool:
    return bool((np.abs(values) > TOLERANCE * limit).any())


def _length_beyond(vector: np.ndarray, limit: float) -> bool:
    return bool(np.abs(vector).max() > TOLERANCE * limit or vector @ vector > (TOLERANCE * limit) ** 2)
